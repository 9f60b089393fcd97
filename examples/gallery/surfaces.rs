//! Scenes about what is on surfaces: normals, pictures, holes, bumps. All pictures are computed.

use std::error::Error;
use std::f64::consts::TAU;

use outcrop::MemoryBudget;
use outcrop::model::{ImageMap, MaterialImages, MaterialRecord};
use outcrop::scene::{Effect, Light, Scene};
use outcrop::texture::{Encoding, ImageKey, PixelImage, Textures};

use crate::mesh::Mesh;
use crate::scenes::{Entry, camera, daylight, ground, matt, metal, panel, shiny, sky};

/// A number from 0 to 1 for each place, without pattern.
pub fn noise(x: u32, y: u32) -> f64 {
    let mut hash = x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 15).wrapping_mul(0x2c1b_3c6d);
    hash = (hash ^ hash >> 12).wrapping_mul(0x297a_2d39);
    f64::from(hash ^ hash >> 15) / f64::from(u32::MAX)
}

/// Noise that is smooth over `cell` texels and repeats after `side`.
pub fn clouds(x: u32, y: u32, cell: u32, side: u32) -> f64 {
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (i, j) = (x / cell, y / cell);
    let (s, t) = (ease(f64::from(x % cell) / f64::from(cell)), ease(f64::from(y % cell) / f64::from(cell)));
    let at = |di: u32, dj: u32| noise((i + di) % (side / cell), (j + dj) % (side / cell) + 977 * cell);
    let (above, below) = (at(0, 0) * (1.0 - s) + at(1, 0) * s, at(0, 1) * (1.0 - s) + at(1, 1) * s);
    above * (1.0 - t) + below * t
}

fn picture(
    name: &str,
    encoding: Encoding,
    side: u32,
    texel: impl Fn(u32, u32) -> [f64; 4],
) -> (ImageKey, PixelImage) {
    let texels = (0..side * side).map(|index| {
        texel(index % side, index / side).map(|channel| (255.0 * channel.clamp(0.0, 1.0)).round() as u8)
    });
    (
        ImageKey { path: name.into(), encoding },
        PixelImage { width: side, height: side, texels: texels.collect() },
    )
}

/// Courses of bricks on a square of `side` texels, four by eight: which brick, and how far inside it.
fn brick(x: u32, y: u32, side: u32) -> ([u32; 2], f64) {
    let row = y * 8 / side;
    let shifted = (x + if row % 2 == 1 { side / 8 } else { 0 }) % side;
    let within = |at: u32, size: u32| f64::from(at % size).min(f64::from(size - 1 - at % size));
    ([shifted * 4 / side, row], within(shifted, side / 4).min(within(y, side / 8)))
}

pub fn with(record: MaterialRecord, images: MaterialImages) -> MaterialRecord {
    MaterialRecord { images: Some(Box::new(images)), ..record }
}

pub fn colored(name: &str) -> MaterialImages {
    MaterialImages { diffuse: Some(ImageMap::new(name)), ..MaterialImages::default() }
}

pub fn smooth_normals() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let clay = mesh.material("clay", shiny([0.72, 0.45, 0.3]));
    let chrome = mesh.material("chrome", metal([0.85, 0.86, 0.88]));
    let whole = [1.0; 2];
    mesh.globe(clay, [-1.2, 0.5, 0.0], 0.5, 8, false, whole);
    mesh.globe(clay, [-0.1, 0.5, 0.0], 0.5, 8, true, whole);
    mesh.globe(chrome, [1.0, 0.5, 0.0], 0.5, 8, true, whole);
    let scene = Scene::new(camera([0.0, 1.5, 4.8], [-0.1, 0.45, 0.0], 36.0)?)
        .with_background([0.6, 0.7, 0.82])
        .with_ambient([0.1, 0.11, 0.13])
        .with_light(Light::directional([0.9, -0.6, -0.5], [0.9, 0.86, 0.78]));
    let (name, title) =
        ("smooth-normals", "The same 256 triangles without normals, with them, and as a mirror");
    Ok(Entry::new([name, title], &[Effect::SmoothNormals], mesh, scene, 16))
}

pub fn textures(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    let tiles = picture("tiles", Encoding::Srgb, 256, |x, y| {
        let (within, is_dark) =
            ((x % 64).min(63 - x % 64).min(y % 64).min(63 - y % 64), (x / 64 + y / 64) % 2 == 1);
        let grain = 0.85 + 0.3 * (clouds(x, y, 16, 256) - 0.5) + 0.1 * (noise(x, y) - 0.5);
        let tone = match (within < 2, is_dark) {
            (true, _) => [0.42, 0.4, 0.38],
            (false, true) => [0.35, 0.2, 0.16],
            (false, false) => [0.82, 0.76, 0.64],
        };
        [tone[0] * grain, tone[1] * grain, tone[2] * grain, 1.0]
    });
    let wall = picture("wall", Encoding::Srgb, 256, |x, y| {
        let ([column, row], inside) = brick(x, y, 256);
        let tone = 0.75 + 0.5 * (noise(column, row) - 0.5);
        let grain = 0.9 + 0.25 * (clouds(x, y, 8, 256) - 0.5);
        let color =
            if inside < 2.5 { [0.75, 0.73, 0.7] } else { [0.66, 0.3, 0.2].map(|channel| channel * tone) };
        [color[0] * grain, color[1] * grain, color[2] * grain, 1.0]
    });
    let globe = picture("globe", Encoding::Srgb, 256, |x, y| {
        let height = 0.6 * clouds(x, y, 64, 256) + 0.3 * clouds(x, y, 32, 256) + 0.1 * clouds(x, y, 8, 256);
        match (height > 0.5, !(24..232).contains(&y)) {
            (_, true) => [0.92, 0.95, 0.97, 1.0],
            (true, _) => [0.25 + height * 0.4, 0.5, 0.2, 1.0],
            (false, _) => [0.1, 0.25 + 0.4 * height, 0.6, 1.0],
        }
    });
    let floor = mesh.material("floor", with(matt([0.9; 3]), colored("tiles")));
    let bricks = mesh.material("bricks", with(matt([0.95; 3]), colored("wall")));
    let planet = mesh.material("planet", with(shiny([1.0; 3]), colored("globe")));
    mesh.card(floor, [-20.0, 0.0, -35.0], [0.0, 0.0, 40.0], [40.0, 0.0, 0.0], [20.0, 20.0]);
    mesh.card(bricks, [-2.4, 0.0, -0.6], [1.7, 0.0, -0.9], [0.0, 1.5, 0.0], [1.6, 1.2]);
    mesh.globe(planet, [0.55, 0.6, 0.0], 0.6, 24, true, [1.0; 2]);
    let scene = Scene::new(camera([0.0, 1.1, 4.4], [0.0, 0.6, 0.0], 40.0)?)
        .with_environment(sky(budget)?)
        .with_textures(Textures::in_memory([tiles, wall, globe])?);
    let (name, title) = ("textures", "Pictures on a floor up to the horizon, a wall and a globe");
    Ok(Entry::new([name, title], &[Effect::Textures], mesh, scene, 16))
}

pub fn cut_outs() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    // A twig with nine leaves.
    let leaves = picture("leaves", Encoding::Srgb, 256, |x, y| {
        let [u, v] = [f64::from(x) / 255.0 - 0.5, 1.0 - f64::from(y) / 255.0];
        let is_stem = u.abs() < 0.012 * (1.2 - v) && v < 0.86;
        let leaf = (0..9).find_map(|leaf| {
            let side = if leaf % 2 == 0 { 1.0 } else { -1.0 };
            let (foot, angle) = match leaf {
                8 => ([0.0, 0.72], TAU / 4.0),
                leaf => ([0.0, 0.12 + 0.085 * f64::from(leaf)], TAU / 4.0 - side * 1.0),
            };
            let (sin, cos) = angle.sin_cos();
            let [du, dv] = [u - foot[0], v - foot[1]];
            let (along, across) = (du * cos + dv * sin, dv * cos - du * sin);
            let t = along / 0.36;
            let width = 0.09 * (4.0 * t * (1.0 - t)).max(0.0).powf(0.8);
            (0.0 < t && t < 1.0 && across.abs() < width).then_some((t, across / width))
        });
        match (leaf, is_stem) {
            (Some((t, across)), _) => {
                let vein = if across.abs() < 0.06 { 1.25 } else { 1.0 - 0.25 * across.abs() };
                [(0.22 + 0.2 * t) * vein, (0.5 + 0.12 * t) * vein, 0.14 * vein, 1.0]
            }
            (None, true) => [0.3, 0.24, 0.12, 1.0],
            (None, false) => [0.3, 0.55, 0.2, 0.0],
        }
    });
    let foliage = mesh.material("foliage", with(matt([1.0; 3]), colored("leaves")));
    for card in 0..46u32 {
        let at = |salt: u32| noise(card, salt);
        let (turn, lean) = (TAU * at(1), 0.5 * (at(2) - 0.5));
        let radius = 1.5 * at(3).sqrt();
        let (sin, cos) = turn.sin_cos();
        let (size, place) = (0.5 + 0.5 * at(4), TAU * at(5));
        let foot = [radius * place.cos(), 0.0, radius * place.sin() - 0.3];
        let a = [size * cos, 0.0, size * sin];
        let b = [-lean * size * sin, 1.5 * size, lean * size * cos];
        mesh.card(foliage, [0, 1, 2].map(|axis| foot[axis] - 0.5 * a[axis]), a, b, [1.0; 2]);
    }
    let scene = daylight(camera([0.3, 1.9, 4.6], [0.0, 0.55, 0.0], 38.0)?)
        .with_textures(Textures::in_memory([leaves])?);
    let (name, title) = ("alpha-cutouts", "Foliage: 46 cards of two triangles each, and their shadows");
    Ok(Entry::new([name, title], &[Effect::AlphaCutouts], mesh, scene, 16))
}

pub fn bumps() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let courses = picture("courses", Encoding::Linear, 256, |x, y| {
        let (_, inside) = brick(x, y, 256);
        let height = 0.8 * (inside / 5.0).min(1.0) + 0.2 * clouds(x, y, 8, 256);
        [height, height, height, 1.0]
    });
    // Round dents in rows, as normals.
    let dents = picture("dents", Encoding::Linear, 256, |x, y| {
        let [u, v] = [x, 255 - y].map(|at| f64::from(at % 64) / 31.5 - 1.0);
        let r = u.hypot(v);
        let slope = if r < 0.8 { -0.8 } else { 0.0 };
        let normal = [slope * u, slope * v, 1.0];
        let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
        let [x, y, z] = normal.map(|x| 0.5 + 0.5 * x / length);
        [x, y, z, 1.0]
    });
    let bump = MaterialImages {
        bump: Some(ImageMap { strength: 4.0, ..ImageMap::new("courses") }),
        ..MaterialImages::default()
    };
    let normal = || MaterialImages { normal: Some(ImageMap::new("dents")), ..MaterialImages::default() };
    let plain = mesh.material("plain wall", matt([0.7, 0.55, 0.48]));
    let wall = mesh.material("bumped wall", with(matt([0.7, 0.55, 0.48]), bump));
    let ball = mesh.material("dented ball", with(shiny([0.3, 0.45, 0.6]), normal()));
    let silver = mesh.material("dented silver", with(metal([0.85, 0.85, 0.82]), normal()));
    mesh.card(plain, [-2.3, 0.0, -0.9], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [1.5, 1.5]);
    mesh.card(wall, [-0.75, 0.0, -0.9], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [1.5, 1.5]);
    mesh.globe(ball, [-0.5, 0.42, 0.35], 0.42, 24, true, [4.0, 2.0]);
    mesh.globe(silver, [1.25, 0.55, 0.0], 0.55, 24, true, [4.0, 2.0]);
    let scene = Scene::new(camera([0.0, 1.4, 4.8], [-0.1, 0.55, 0.0], 38.0)?)
        .with_background([0.6, 0.7, 0.82])
        .with_ambient([0.12, 0.12, 0.14])
        .with_light(Light::directional([0.8, -0.7, -0.55], [0.75, 0.72, 0.66]))
        .with_light(panel([0.0, 3.0, 2.0], 1.0, 1.0, [2.0, 2.0, 2.0]))
        .with_textures(Textures::in_memory([courses, dents])?);
    let (name, title) =
        ("bump-maps", "A wall without bumps and one with (heights), and dents in two balls (normals)");
    Ok(Entry::new([name, title], &[Effect::BumpMaps], mesh, scene, 16))
}

pub fn finishes(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    // Steel under red paint that flakes off: where it is bare it is metal, polished in the middle of the flakes.
    let bare = |x: u32, y: u32| 0.6 * clouds(x, y, 32, 256) + 0.4 * clouds(x, y, 8, 256) - 0.5;
    let is_bare = |x: u32, y: u32| bare(x, y) > 0.0;
    let color = picture("paint", Encoding::Srgb, 256, |x, y| {
        if is_bare(x, y) { [0.78, 0.77, 0.75, 1.0] } else { [0.62, 0.1, 0.08, 1.0] }
    });
    let finish = picture("finish", Encoding::Linear, 256, |x, y| {
        let worn = if is_bare(x, y) { 0.55 - 2.5 * bare(x, y) } else { 0.5 + 0.4 * clouds(x, y, 16, 256) };
        [0.0, worn.max(0.12), if is_bare(x, y) { 1.0 } else { 0.0 }, 1.0]
    });
    // One metal, brushed in bands.
    let bands = picture("bands", Encoding::Linear, 256, |_, y| {
        [0.0, if y / 16 % 2 == 0 { 0.1 } else { 0.6 }, 1.0, 1.0]
    });
    let of = |name: &str, colors: MaterialImages| MaterialImages {
        roughness: Some(ImageMap::new(name)),
        metalness: Some(ImageMap::new(name)),
        ..colors
    };
    let metal = |diffuse: [f32; 3]| MaterialRecord {
        specular: [0.04; 3],
        metalness: 1.0,
        roughness: 1.0,
        exponent_by_roughness: true,
        ..matt(diffuse)
    };
    let painted = mesh.material("painted steel", with(metal([1.0; 3]), of("finish", colored("paint"))));
    let gold =
        mesh.material("banded gold", with(metal([1.0, 0.77, 0.34]), of("bands", MaterialImages::default())));
    mesh.globe(painted, [-0.75, 0.7, 0.0], 0.7, 32, true, [2.0, 1.0]);
    mesh.globe(gold, [0.8, 0.6, 0.1], 0.6, 32, true, [1.0; 2]);
    let scene = Scene::new(camera([0.0, 1.5, 4.6], [0.0, 0.6, 0.0], 38.0)?)
        .with_environment(sky(budget)?)
        .with_light(panel([0.0, 3.0, 2.0], 1.0, 1.0, [2.0, 2.0, 2.0]))
        .with_textures(Textures::in_memory([color, finish, bands])?);
    let (name, title) = (
        "finish-maps",
        "Steel where the paint is off, and gold in rough and smooth bands: by texel of one picture",
    );
    Ok(Entry::new([name, title], &[Effect::FinishMaps], mesh, scene, 25))
}
