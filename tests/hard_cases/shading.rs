//! What surfaces look like where two of them meet, where a picture begins and ends, and where normals are wrong.

use std::path::Path;
use std::sync::Arc;

use outcrop::compile::{CompileOptions, Control, Threads, compile_file};
use outcrop::model::MaterialRecord;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{CUBOID_FACES, cuboid_corners};
use outcrop::render::{RenderSettings, RenderedImage, Renderer};
use outcrop::scene::{Camera, Effect, EffectSet, Finish, Light, Scene};
use outcrop::source::{DiskSource, MemorySource};
use outcrop::texture::Textures;
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

use crate::cases::{Random, along, unit};
use crate::compiling::{Mesh, Vertices, compile};
use crate::everywhere::open;

const TRANSLATIONS: [f64; 2] = [0.0, 1e6];

fn render(source: &Arc<dyn BlockSource>, scene: &Scene, settings: &RenderSettings) -> RenderedImage {
    let octree = open(source, OctreeOptions::default());
    let renderer = Renderer::new(&octree, scene, settings, &MemoryBudget::new(Bytes::mib(64))).unwrap();
    renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap()
}

/// Boxes given by material and two corners, about `center`.
fn boxes(center: [f64; 3], parts: &[(u16, [f64; 3], [f64; 3])], records: Vec<MaterialRecord>) -> Mesh {
    let (mut vertices, mut triangles, mut materials) = (Vec::new(), Vec::new(), Vec::new());
    for (material, low, high) in parts {
        let first = vertices.len() as u32;
        vertices.extend(cuboid_corners(along(center, 1.0, *low), along(center, 1.0, *high)));
        triangles.extend(CUBOID_FACES.map(|face| face.map(|corner| corner + first)));
        materials.extend([*material; 12]);
    }
    Mesh { materials, records, ..Mesh::new(Vertices::Float64(vertices), triangles) }
}

#[test]
fn coincident_glass_and_water_keep_the_stack_balanced() {
    let named = |name: &str, refractive_index: f32, transmission: [f32; 3]| MaterialRecord {
        name: name.to_string(),
        diffuse: [0.0; 3],
        opacity: 0.0,
        refractive_index,
        transmission,
        ..MaterialRecord::default()
    };
    let records = || vec![named("glass", 1.5, [1.0; 3]), named("water", 1.25, [1.0, 0.5, 0.25])];
    // A tank: water fills a box of glass to its walls and its bottom, and stands one unit high.
    let parts = [
        (0, [-4.0, -1.0, -4.0], [4.0, 0.0, 4.0]),
        (0, [-4.0, 0.0, -4.0], [-3.0, 2.0, 4.0]),
        (0, [3.0, 0.0, -4.0], [4.0, 2.0, 4.0]),
        (0, [-3.0, 0.0, -4.0], [3.0, 2.0, -3.0]),
        (0, [-3.0, 0.0, 3.0], [3.0, 2.0, 4.0]),
        (1, [-3.0, 0.0, -3.0], [3.0, 1.0, 3.0]),
    ];
    let settings =
        RenderSettings { contribution_bound: 1e-6, work_budget: 1 << 16, ..RenderSettings::new(12, 12) };
    for translation in TRANSLATIONS {
        let center = [translation, -translation, translation];
        for block_bytes in [4 << 10, 64 << 10] {
            let options = CompileOptions { block_bytes, ..Default::default() };
            let mesh = boxes(center, &parts, records());
            let bytes = compile(&mesh, &options, Bytes::mib(64)).1;
            let source: Arc<dyn BlockSource> = Arc::new(MemorySource::new(bytes).unwrap());
            let ranked = |camera| {
                Scene::new(camera)
                    .with_background([1.0; 3])
                    .with_finish("glass", Finish::nested(2))
                    .with_finish("water", Finish::nested(1))
            };
            // From above, face on: water, the border of both, glass. All reflections between the three added up.
            let above = along(center, 1.0, [0.1, 9.0, 0.2]);
            let camera =
                Camera::orthographic(above, along(above, 1.0, [0.0, -1.0, 0.0]), [0.0, 0.0, 1.0], 1.0)
                    .unwrap();
            let one = RenderSettings { width: 1, height: 1, ..settings };
            let image = render(&source, &ranked(camera), &one);
            let fresnel = |a: f64, b: f64| ((a - b) / (a + b)).powi(2);
            let (r1, r2, r3) = (fresnel(1.0, 1.25), fresnel(1.25, 1.5), fresnel(1.5, 1.0));
            for (channel, layer) in [1.0, 0.5, 0.25].into_iter().enumerate() {
                // What is below the water's surface as one: glass, with its own reflections.
                let below_t = (1.0 - r2) * (1.0 - r3) / (1.0 - r2 * r3);
                let below_r = r2 + (1.0 - r2) * (1.0 - r2) * r3 / (1.0 - r2 * r3);
                let between = 1.0 - r1 * below_r * layer * layer;
                let seen = (1.0 - r1) * layer * below_t / between
                    + r1
                    + (1.0 - r1) * (1.0 - r1) * layer * layer * below_r / between;
                let found = f64::from(image.film.pixel(0, 0)[channel]);
                assert!(
                    (found - seen).abs() < 1e-4,
                    "channel {channel} at {translation}: {found}, not {seen}"
                );
            }
            // Through walls, water and edges at a slant: nothing is absorbed in red, wherever a ray leaves.
            let eye = along(center, 1.0, [13.0, 8.0, 17.0]);
            let camera = Camera::pinhole(eye, center, [0.0, 1.0, 0.0], 25.0).unwrap();
            let image = render(&source, &ranked(camera), &settings);
            let effects = &image.report.effects;
            assert_eq!(effects.medium_overflows, 0);
            assert!(effects.medium_rays > 1000, "{effects:?}");
            for pixel in image.film.pixels() {
                assert!((0.995..=1.000_001).contains(&pixel[0]), "{pixel:?}");
                assert!(pixel[2] <= pixel[1] + 1e-6 && pixel[1] <= pixel[0] + 1e-6, "{pixel:?}");
            }
            let clear = image.film.pixels().iter().filter(|pixel| pixel[2] > 0.995).count();
            assert!((1..140).contains(&clear), "water is seen in some pixels and not in others: {clear}");
        }
    }
}

/// An OBJ model with its materials and pictures, compiled.
fn compiled(folder: &Path, obj: &str, mtl: &str, block_bytes: u32) -> Arc<dyn BlockSource> {
    std::fs::write(folder.join("model.obj"), format!("mtllib model.mtl\n{obj}")).unwrap();
    std::fs::write(folder.join("model.mtl"), mtl).unwrap();
    let output = folder.join(format!("model{block_bytes}.outcrop"));
    let options = CompileOptions { block_bytes, ..Default::default() };
    let budget = MemoryBudget::new(Bytes::mib(64));
    compile_file(folder.join("model.obj"), &output, &options, &budget, &mut |_| Control::Continue).unwrap();
    Arc::new(DiskSource::open(&output).unwrap())
}

fn with_pictures(scene: Scene, source: &Arc<dyn BlockSource>, folder: &Path) -> Scene {
    let budget = MemoryBudget::new(Bytes::mib(16));
    let tiles = folder.join("model.tiles");
    scene.with_textures(Textures::open(&source.model().materials, folder, &tiles, &budget).unwrap())
}

/// Writes a picture of one grey, with this alpha in each texel.
fn write_alpha(path: &Path, [width, height]: [u32; 2], alpha: impl Fn(u32, u32) -> u8) {
    let texels = (0..width * height).flat_map(|i| [255, 255, 255, alpha(i % width, i / width)]);
    let bytes: Vec<u8> = texels.collect();
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), width, height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
}

/// A card with holes above a floor, light straight from above, seen from straight above: where the card is not, the light comes through.
#[test]
fn alpha_exactly_at_a_hit() {
    for translation in TRANSLATIONS {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path();
        // Texels that are there and that are not side by side: between them alpha passes exactly one half, at whole coordinates.
        write_alpha(&folder.join("holes.png"), [8, 8], |x, y| if (x + y) % 2 == 0 { 255 } else { 0 });
        let at = |x: f64, y: f64, z: f64| {
            format!("v {} {} {}\n", translation + x, translation + y, translation + z)
        };
        let mut obj = [at(0.0, 0.0, 1.0), at(8.0, 0.0, 1.0), at(8.0, 8.0, 1.0), at(0.0, 8.0, 1.0)].concat();
        obj += &[at(-4.0, -4.0, 0.0), at(12.0, -4.0, 0.0), at(12.0, 12.0, 0.0), at(-4.0, 12.0, 0.0)].concat();
        obj += "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl card\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\nusemtl floor\nf 5 6 7\nf 5 7 8\n";
        let mtl = "newmtl card\nKd 0 0 0\nKe 1 0 0\nmap_Kd holes.png\nnewmtl floor\nKd 1 1 1\n";
        let source = compiled(folder, &obj, mtl, 4 << 10);
        // Pixels whose middles are multiples of an eighth, so that many rays meet a texel's border, a corner of the card or its diagonal.
        let eye = along([translation; 3], 1.0, [4.0, 4.0, 9.0]);
        let camera =
            Camera::orthographic(eye, along(eye, 1.0, [0.0, 0.0, -1.0]), [0.0, 1.0, 0.0], 12.125).unwrap();
        let scene = Scene::new(camera).with_light(Light::directional([0.0, 0.0, -1.0], [0.0, 1.0, 0.0]));
        let scene = with_pictures(scene, &source, folder);
        let image = render(&source, &scene, &RenderSettings::new(97, 97));
        let (mut card, mut floor) = (0, 0);
        for (index, pixel) in image.film.pixels().iter().enumerate() {
            match *pixel {
                [1.0, 0.0, 0.0] => card += 1,
                [0.0, green, 0.0] if green > 0.99 => floor += 1,
                _ => panic!("pixel {index} at {translation} is a hole for one kind of ray: {pixel:?}"),
            }
        }
        // A border belongs to the card: exactly one half is there.
        assert!(card > 2000 && floor > 5000, "{card} {floor}");
        let seen = |x: f64, y: f64| {
            let [column, row] = [x - 4.0, 4.0 - y].map(|offset| (offset / 0.125 + 48.0).round() as u32);
            image.film.pixel(column, row)[0]
        };
        // The upper left texel is there, its right neighbour is not; their border, and the corner of four, are.
        assert_eq!([seen(0.5, 7.5), seen(1.5, 7.5), seen(1.0, 7.5), seen(1.0, 7.0)], [1.0, 0.0, 1.0, 1.0]);
        assert!(image.report.effects.cutouts_passed > 1000);
    }
}

/// The same wall with its picture, in one piece and cut into strips whose coordinates begin anew at each seam.
#[test]
fn texture_seams_do_not_show() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    let mut random = Random(31);
    let texels: Vec<u8> = (0..16 * 16 * 3).map(|_| random.bits() as u8).collect();
    let mut encoder = png::Encoder::new(std::fs::File::create(folder.join("noise.png")).unwrap(), 16, 16);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&texels).unwrap();
    let mtl = "newmtl wall\nKd 1 1 1\nmap_Kd noise.png\n";
    let wall = |seams: &[(f64, i32)]| {
        let mut obj = String::from("usemtl wall\n");
        for pair in seams.windows(2) {
            let ([(from, turn), (to, _)], top) = ([pair[0], pair[1]], 8.0);
            for (x, y) in [(from, 0.0), (to, 0.0), (to, top), (from, top)] {
                // The picture repeats at whole numbers.
                obj +=
                    &format!("v {x} {y} 0\nvt {} {}\n", x / 4.0 + f64::from(turn), y / 4.0 - f64::from(turn));
            }
            obj += "f -4/-4 -3/-3 -2/-2\nf -4/-4 -2/-2 -1/-1\n";
        }
        obj
    };
    let eye = [4.0, 4.0, 9.0];
    let views = [
        // Rays exactly at seams, and at a slant.
        Camera::orthographic(eye, [4.0, 4.0, 0.0], [0.0, 1.0, 0.0], 6.0).unwrap(),
        Camera::pinhole([9.0, 1.0, 3.0], [4.0, 4.0, 0.0], [0.0, 1.0, 0.0], 40.0).unwrap(),
    ];
    let picture = |seams: &[(f64, i32)], view: Camera, block_bytes| {
        let source = compiled(folder, &wall(seams), mtl, block_bytes);
        let scene = with_pictures(Scene::new(view).with_ambient([1.0; 3]), &source, folder);
        render(&source, &scene, &RenderSettings::new(49, 49))
    };
    for view in views {
        let whole = picture(&[(0.0, 0), (8.0, 0)], view, 64 << 10);
        assert!(whole.report.effects.texture_reads > 1000);
        let cut = [(0.0, 0), (1.0, 3), (2.5, -2), (4.0, 1), (4.0625, 0), (6.0, -7), (8.0, 0)];
        for block_bytes in [4 << 10, 64 << 10] {
            let strips = picture(&cut, view, block_bytes);
            for (found, expected) in strips.film.pixels().iter().zip(whole.film.pixels()) {
                for channel in 0..3 {
                    assert!((found[channel] - expected[channel]).abs() < 1e-4, "{found:?} {expected:?}");
                }
            }
        }
    }
}

/// The normal at a corner, by what is right there and the corner's number; `None`: no corner has one.
type NormalAt<'n> = dyn Fn([f64; 3], usize) -> Option<[f64; 3]> + 'n;

/// A dome whose normals at the corners are right, turned inside out, all across, and none at all.
#[test]
fn normals_that_face_away() {
    let steps = 12;
    let dome = |normal: &NormalAt| {
        let mut obj = String::from("usemtl clay\n");
        let point = |i: usize, j: usize| {
            let (x, y) = (i as f64 / 6.0 - 1.0, j as f64 / 6.0 - 1.0);
            [x, y, 1.0 - 0.4 * (x * x + y * y)]
        };
        let mut count = 0;
        for i in 0..steps {
            for j in 0..steps {
                for corner in [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]] {
                    let [x, y, z] = point(corner[0], corner[1]);
                    obj += &format!("v {x} {y} {z}\n");
                    if let Some([x, y, z]) = normal(unit([0.8 * x, 0.8 * y, 1.0]), count) {
                        obj += &format!("vn {x} {y} {z}\n");
                    }
                    count += 1;
                }
                let faces = if normal([0.0, 0.0, 1.0], 0).is_some() {
                    "f -4//-4 -3//-3 -2//-2\nf -4//-4 -2//-2 -1//-1\n"
                } else {
                    "f -4 -3 -2\nf -4 -2 -1\n"
                };
                obj += faces;
            }
        }
        obj
    };
    let place = tempfile::tempdir().unwrap();
    let lamp = Light::directional([-0.5, 0.3, -1.0], [1.0; 3]);
    let picture = |normal: &NormalAt| {
        let source = compiled(place.path(), &dome(normal), "newmtl clay\nKd 0.8 0.8 0.8\n", 4 << 10);
        let camera = Camera::pinhole([1.0, -2.0, 5.0], [0.0, 0.0, 0.8], [0.0, 1.0, 0.0], 25.0).unwrap();
        let image = render(&source, &Scene::new(camera).with_light(lamp), &RenderSettings::new(40, 40));
        image.film.pixels().iter().map(|pixel| pixel[0]).collect::<Vec<f32>>()
    };
    let right = picture(&|normal, _| Some(normal));
    let flat = picture(&|_, _| None);
    let lit = flat.iter().filter(|x| **x > 0.1).count();
    assert!(lit > 600, "{lit}");
    // The side that is seen counts, not the side that normals are on (but for the rounding of stored normals).
    let inside_out = picture(&|normal, _| Some(normal.map(|x| -x)));
    for (found, expected) in inside_out.iter().zip(&right) {
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
    }
    // Smooth and flat agree up to the facets.
    for (smooth, flat) in right.iter().zip(&flat) {
        assert!((smooth - flat).abs() < 0.15, "{smooth} {flat}");
    }
    // Across, from behind one by one, of no use at all: never more light than there is, nothing lost that the triangle would show, no NaN.
    let wrong: [&NormalAt; 4] = [
        &|[x, y, _], _| Some(unit([1.0 + x, y, 0.0])),
        &|normal, count| Some(if count % 3 == 0 { normal.map(|x| -x) } else { normal }),
        &|[x, y, z], _| Some([-y, x, -0.1 * z]),
        &|_, count| Some([0.0, 0.0, if count % 2 == 0 { 1e-30 } else { -1.0 }]),
    ];
    for (number, normal) in wrong.into_iter().enumerate() {
        let found = picture(normal);
        assert!(found.iter().all(|x| (0.0..=0.801).contains(x)), "case {number}");
        // What is outside of the dome stays dark.
        for (x, flat) in found.iter().zip(&flat) {
            assert!(*flat > 0.0 || *x == 0.0, "case {number}");
        }
    }
}

/// A coarse ball with the normals of the sphere in light from the side. Its triangles are flat, so near the line where light ends
/// one that the light still falls on by its normals lies in the shadow of its neighbours.
#[test]
fn the_shadow_terminator_of_a_coarse_ball() {
    const RINGS: u32 = 10;
    let place = tempfile::tempdir().unwrap();
    for translation in TRANSLATIONS {
        let mut obj = String::from("usemtl clay\n");
        for ring in 0..=RINGS {
            for segment in 0..2 * RINGS {
                let (down, around) = (
                    std::f64::consts::PI * f64::from(ring) / f64::from(RINGS),
                    std::f64::consts::PI * f64::from(segment) / f64::from(RINGS),
                );
                let [x, y, z] = [down.sin() * around.cos(), down.cos(), -down.sin() * around.sin()];
                let [px, py, pz] = [x, y, z].map(|x| translation + x);
                obj += &format!("v {px} {py} {pz}\nvn {x} {y} {z}\n");
            }
        }
        for (ring, segment) in (0..RINGS).flat_map(|ring| (0..2 * RINGS).map(move |segment| (ring, segment)))
        {
            let at = |down: u32, right: u32| (ring + down) * 2 * RINGS + (segment + right) % (2 * RINGS) + 1;
            let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            if ring + 1 < RINGS {
                obj += &format!("f {a}//{a} {b}//{b} {c}//{c}\n");
            }
            if ring > 0 {
                obj += &format!("f {a}//{a} {c}//{c} {d}//{d}\n");
            }
        }
        let source = compiled(place.path(), &obj, "newmtl clay\nKd 1 1 1\n", 4 << 10);
        // The light comes straight from the right, so brightness is how far right the sphere's own normal points.
        let eye = along([translation; 3], 1.0, [0.0, 0.0, 5.0]);
        let camera = Camera::orthographic(eye, [translation; 3], [0.0, 1.0, 0.0], 2.0).unwrap();
        let scene = Scene::new(camera).with_light(Light::directional([-1.0, 0.0, 0.0], [1.0; 3]));
        const SIDE: u32 = 101;
        let settings = RenderSettings::new(SIDE, SIDE);
        let smooth = render(&source, &scene, &settings);
        let flat = RenderSettings { switched_off: EffectSet::EMPTY.with(Effect::SmoothNormals), ..settings };
        let flat = render(&source, &scene, &flat);
        let (mut checked, mut facets) = (0, 0);
        for (row, column) in (0..SIDE).flat_map(|row| (0..SIDE).map(move |column| (row, column))) {
            let at = |pixel: u32| (f64::from(pixel) + 0.5) / f64::from(SIDE) * 2.0 - 1.0;
            let (x, y) = (at(column), -at(row));
            // Seen from the front, and not where the rim of the facets ends.
            if x * x + y * y > 0.8 {
                continue;
            }
            let found = f64::from(smooth.film.pixel(column, row)[0]);
            let expected = x.max(0.0);
            // A normal between corners is off by what a chord is; no pixel is black that should not be, and none lit.
            assert!((found - expected).abs() < 0.04, "({x}, {y}) at {translation}: {found}, not {expected}");
            assert!(x < 0.03 || found > 0.0, "({x}, {y}) at {translation} is in a neighbour's shadow");
            checked += 1;
            facets += usize::from((f64::from(flat.film.pixel(column, row)[0]) - expected).abs() > 0.04);
        }
        assert!(checked > 6000 && facets > 1000, "{checked} {facets}");
    }
}
