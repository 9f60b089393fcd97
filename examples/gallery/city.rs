//! A city whose facades are images: more of them than the cache of textures holds.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use outcrop::MemoryBudget;
use outcrop::scene::{Environment, Scene};
use outcrop::texture::Textures;
use outcrop::units::Bytes;

use crate::mesh::Mesh;
use crate::scenes::{Entry, camera, matt, sky};
use crate::surfaces::{clouds, colored, noise, with};

/// Facades that differ.
const FACADES: u32 = 16;
/// Floors and windows across of an image.
const FLOORS: u32 = 8;
const BAYS: u32 = 6;
const FLOOR_HEIGHT: f64 = 3.4;
const BAY_WIDTH: f64 = 3.2;
/// From the middle of a street to the middle of the next.
const LOT: f64 = 44.0;

type Rgb = [f64; 3];

fn mix(a: Rgb, b: Rgb, part: f64) -> Rgb {
    [0, 1, 2].map(|channel| a[channel] + part * (b[channel] - a[channel]))
}

fn scaled(color: Rgb, factor: f64) -> Rgb {
    color.map(|channel| channel * factor)
}

/// What stands between the windows of a facade.
#[derive(Clone, Copy)]
enum Wall {
    Bricks,
    Plaster,
    /// Windows in one band per floor.
    Bands,
    /// Glass from floor to floor.
    Curtain,
}

fn style(facade: u32) -> (Wall, Rgb) {
    let tone = 0.9 + 0.2 * noise(facade, 71);
    let pick = |colors: [Rgb; 4]| scaled(colors[(facade / 4) as usize], tone);
    match facade % 4 {
        0 => (
            Wall::Bricks,
            pick([[0.62, 0.33, 0.24], [0.53, 0.29, 0.2], [0.7, 0.48, 0.34], [0.48, 0.36, 0.31]]),
        ),
        1 => (
            Wall::Plaster,
            pick([[0.85, 0.76, 0.58], [0.8, 0.8, 0.76], [0.83, 0.64, 0.5], [0.68, 0.74, 0.68]]),
        ),
        2 => (
            Wall::Bands,
            pick([[0.72, 0.7, 0.66], [0.6, 0.58, 0.55], [0.78, 0.72, 0.62], [0.66, 0.68, 0.72]]),
        ),
        _ => {
            (Wall::Curtain, pick([[0.5, 0.62, 0.72], [0.42, 0.58, 0.6], [0.6, 0.6, 0.64], [0.62, 0.66, 0.6]]))
        }
    }
}

/// The colour of a facade at a texel of `side`, sRGB; rows from the top.
fn facade(number: u32, side: u32, x: u32, y: u32) -> Rgb {
    let (wall, tone) = style(number);
    let across = f64::from(x) / f64::from(side) * f64::from(BAYS);
    let up = (1.0 - (f64::from(y) + 0.5) / f64::from(side)) * f64::from(FLOORS);
    let (bay, floor) = (across as u32, up as u32);
    let (u, v) = (across.fract(), up.fract());
    let grain = 0.93 + 0.14 * clouds(x, y, side / 16, side) - 0.04 * noise(x / 2, y / 2);
    let key = 97 * number + floor;
    // Glass: darker below, now and then a blind or a lamp behind it.
    let pane = |u: f64, v: f64| {
        let luck = noise(bay + 31 * key, 5);
        let glass = mix([0.13, 0.17, 0.22], [0.38, 0.47, 0.56], 0.75 * v + 0.25 * noise(bay, key));
        let drawn = 1.0 - 0.85 * noise(bay + 7 * key, 9);
        match luck {
            luck if luck < 0.28 && v > drawn => scaled([0.84, 0.8, 0.7], 0.9 + 0.1 * (40.0 * v).sin()),
            luck if luck > 0.95 => mix([0.95, 0.8, 0.5], glass, 0.35),
            _ if (u - 0.5).abs() < 0.025 => scaled(tone, 0.5),
            _ => glass,
        }
    };
    let inside = |low: f64, high: f64, at: f64| (at > low && at < high).then(|| (at - low) / (high - low));
    let stone = match wall {
        Wall::Bricks => {
            let (course, joint) = ((up * 14.0) as u32, (up * 14.0).fract());
            let along = across * 5.0 + 0.5 * f64::from(course % 2);
            let is_mortar = joint < 0.14 || along.fract() < 0.07;
            let brick = scaled(tone, 0.86 + 0.28 * noise(along as u32, course + 300 * number));
            if is_mortar { mix(tone, [0.75, 0.72, 0.68], 0.55) } else { brick }
        }
        Wall::Plaster | Wall::Bands | Wall::Curtain => tone,
    };
    let stone = scaled(stone, grain);
    let ledge = [0.86, 0.83, 0.77];
    match wall {
        Wall::Bricks | Wall::Plaster => match (inside(0.26, 0.74, u), inside(0.24, 0.82, v)) {
            (Some(u), Some(v)) => {
                let is_frame =
                    !(0.07..=0.93).contains(&u) || !(0.05..=0.95).contains(&v) || (v - 0.62).abs() < 0.02;
                if is_frame { [0.9, 0.89, 0.86] } else { pane(u, v) }
            }
            // The sill and its shadow, and a string course below every second floor.
            _ if inside(0.21, 0.79, u).is_some() && inside(0.2, 0.24, v).is_some() => scaled(ledge, grain),
            _ if inside(0.23, 0.8, u).is_some() && inside(0.15, 0.2, v).is_some() => scaled(stone, 0.78),
            _ if v < 0.07 && floor.is_multiple_of(2) => scaled(ledge, 0.94 * grain),
            _ => stone,
        },
        Wall::Bands => match inside(0.36, 0.86, v) {
            Some(v) if u > 0.04 => pane(u, v),
            Some(_) => scaled(tone, 0.6),
            None if v > 0.86 && v < 0.9 => scaled(stone, 0.8),
            None => stone,
        },
        Wall::Curtain => {
            let is_mullion = !(0.03..=0.97).contains(&(2.0 * u).fract());
            match (is_mullion, v) {
                (true, _) => scaled(tone, 0.55),
                (false, v) if v < 0.16 => scaled(tone, 0.75 * grain),
                (false, v) => mix(pane(0.1, v), tone, 0.6),
            }
        }
    }
}

/// One lot from street to street: asphalt with lines, a pavement, paving inside.
fn ground(side: u32, x: u32, y: u32) -> Rgb {
    let at = |texel: u32| (f64::from(texel) + 0.5) / f64::from(side) * LOT;
    let from_street = |at: f64| at.min(LOT - at);
    let (a, b) = (from_street(at(x)), from_street(at(y)));
    let near = a.min(b);
    let grain = 0.9 + 0.2 * clouds(x, y, side / 32, side) - 0.06 * noise(x, y);
    let along = if a < b { at(y) } else { at(x) };
    let is_crossing = a < 5.0 && b < 5.0;
    let color = match near {
        near if near < 0.14 && !is_crossing && (along / 3.0).fract() < 0.55 => [0.85, 0.84, 0.78],
        _ if near < 5.0 && (5.2..7.2).contains(&a.max(b)) && (near * 0.9).fract() < 0.5 => [0.78, 0.77, 0.74],
        near if near < 5.0 => [0.3, 0.3, 0.32],
        near if near < 5.3 => [0.62, 0.61, 0.58],
        near if near < 8.2 => {
            let is_joint = (at(x) / 1.5).fract() < 0.06 || (at(y) / 1.5).fract() < 0.06;
            if is_joint { [0.48, 0.47, 0.45] } else { [0.6, 0.58, 0.55] }
        }
        _ => [0.32, 0.42, 0.24],
    };
    scaled(color, grain)
}

fn write(path: &Path, side: u32, texel: impl Fn(u32, u32) -> Rgb) -> Result<(), Box<dyn Error>> {
    let bytes: Vec<u8> = (0..side * side)
        .flat_map(|index| texel(index % side, index / side))
        .map(|channel| (255.0 * channel.clamp(0.0, 1.0)).round() as u8)
        .collect();
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), side, side);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.write_header()?.write_image_data(&bytes)?;
    Ok(())
}

/// Four walls with a facade, and a roof with a parapet and something on it.
fn house(mesh: &mut Mesh, [wall, roof, plant]: [usize; 3], low: [f64; 2], size: [f64; 2], height: f64) {
    let ([x, z], [w, d]) = (low, size);
    let (tall, bays) = ((height / FLOOR_HEIGHT / f64::from(FLOORS)) as f32, |length: f64| {
        (length / BAY_WIDTH / f64::from(BAYS)) as f32
    });
    let up = [0.0, height, 0.0];
    mesh.card(wall, [x, 0.0, z + d], [w, 0.0, 0.0], up, [bays(w), tall]);
    mesh.card(wall, [x + w, 0.0, z], [-w, 0.0, 0.0], up, [bays(w), tall]);
    mesh.card(wall, [x + w, 0.0, z + d], [0.0, 0.0, -d], up, [bays(d), tall]);
    mesh.card(wall, [x, 0.0, z], [0.0, 0.0, d], up, [bays(d), tall]);
    mesh.quad(roof, [x, height, z], [0.0, 0.0, d], [w, 0.0, 0.0]);
    let middle = [x + 0.5 * w, z + 0.5 * d];
    for (foot, length) in [
        ([middle[0], z + 0.2], [w, 0.4]),
        ([middle[0], z + d - 0.2], [w, 0.4]),
        ([x + 0.2, middle[1]], [0.4, d]),
        ([x + w - 0.2, middle[1]], [0.4, d]),
    ] {
        mesh.block(roof, [foot[0], height, foot[1]], [length[0], 0.9, length[1]], 0.0);
    }
    mesh.block(plant, [middle[0] - 0.15 * w, height, middle[1]], [0.3 * w, 2.6, 0.3 * d], 0.0);
    mesh.block(plant, [middle[0] + 0.25 * w, height, middle[1] - 0.2 * d], [0.15 * w, 1.7, 0.2 * d], 0.0);
}

/// `side` texels across are what each image has.
pub fn city(budget: &MemoryBudget, side: u32) -> Result<Entry, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let mut mesh = Mesh::new();
    let mut walls = Vec::new();
    for number in 0..FACADES {
        let name = format!("facade-{number}.png");
        write(&folder.path().join(&name), side, |x, y| facade(number, side, x, y))?;
        walls.push(mesh.material("facade", with(matt([0.85; 3]), colored(&name))));
    }
    write(&folder.path().join("ground.png"), side, |x, y| ground(side, x, y))?;
    let lot = mesh.material("ground", with(matt([0.9; 3]), colored("ground.png")));
    let roofs = [[0.36, 0.35, 0.34], [0.46, 0.43, 0.4], [0.3, 0.27, 0.25]]
        .map(|tone| mesh.material("roof", matt(tone)));
    let plant = mesh.material("on the roof", matt([0.55, 0.55, 0.54]));
    const LOTS: i32 = 40;
    let edge = f64::from(LOTS) * LOT;
    mesh.card(
        lot,
        [-0.5 * edge, 0.0, -edge + 4.0 * LOT],
        [0.0, 0.0, edge],
        [edge, 0.0, 0.0],
        [LOTS as f32; 2],
    );
    for (column, row) in (-LOTS / 2..LOTS / 2).flat_map(|x| (-LOTS + 4..3).map(move |z| (x, z))) {
        let key = (column + 1000) as u32 * 613 + (row + 1000) as u32;
        let luck = |salt: u32| noise(key, salt);
        // Towers in the middle of the town.
        let [x, z] = [f64::from(column) * LOT, f64::from(row) * LOT];
        let [dx, dz] = [x + 60.0, z + 420.0];
        let center = (-(dx * dx + dz * dz) / (2.0 * 190.0f64.powi(2))).exp();
        // One house, two beside each other or four on each lot, eight metres from the middle of the street.
        let (low, room) = ([x + 8.0, z + 8.0], LOT - 16.0);
        let (parts, is_tower) = ([1, 2, 2][(3.0 * luck(3)) as usize], luck(4) < 0.2 + 0.5 * center);
        let parts = if is_tower { 1 } else { parts };
        for (i, j) in (0..parts).flat_map(|i| (0..parts).map(move |j| (i, j))) {
            let salt = 10 + 4 * (2 * i + j) as u32;
            let share = room / f64::from(parts);
            let inset = if is_tower { 2.0 + 3.0 * luck(5) } else { 0.0 };
            let size = [share - 2.0 * inset - 0.6 * luck(salt), share - 2.0 * inset - 0.6 * luck(salt + 1)];
            let floors = match is_tower {
                true => 10.0 + 8.0 * luck(6) + 34.0 * center * luck(7),
                false => 4.0 + 4.0 * luck(salt + 2) + 4.0 * center,
            };
            // Glass for towers, bricks and plaster for the others.
            let kind = if is_tower { 2 + (2.0 * luck(8)) as usize } else { (2.7 * luck(salt + 3)) as usize };
            let wall = walls[kind + 4 * (4.0 * luck(salt + 50)) as usize];
            let roof = roofs[(3.0 * luck(salt + 60)) as usize];
            let corner = [low[0] + f64::from(i) * share + inset, low[1] + f64::from(j) * share + inset];
            house(&mut mesh, [wall, roof, plant], corner, size, floors.floor() * FLOOR_HEIGHT);
        }
    }
    let textures =
        Textures::open(mesh.materials(), folder.path(), &folder.path().join("city.tiles"), budget)?;
    let environment = match sky(budget)? {
        Environment::Image { image, up, .. } => {
            Environment::Image { image, scale: 1.6, up, front: [0.0, 0.0, 1.0] }
        }
        constant => constant,
    };
    let scene = Scene::new(camera([25.0, 92.0, 165.0], [-22.0, 22.0, -160.0], 40.0)?)
        .with_environment(environment)
        .with_textures(textures);
    let note = "Facades and ground are 17 images of 1024 x 1024 texels, written as PNG files by the example and converted to tiles on disk. \
                Attributes and tiles get less memory than the picture looks up, so tiles leave and come back; the example fails if the picture is not \
                the same to the bit with room for all.";
    let (name, title) = ("city", "A city with textures, out of core");
    Ok(Entry {
        note,
        detail_bytes: Some(Bytes(1 << 20)),
        folder: Some(folder),
        ..Entry::new([name, title], &[], mesh, scene, 36)
    })
}
