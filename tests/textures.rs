//! Pictures larger than the memory that they are given: the same to the bit as with all of them in memory.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Control, Threads, compile_file};
use outcrop::error::RenderError;
use outcrop::model::Model;
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::render::{RenderSettings, RenderedImage, Renderer, WaitingRays};
use outcrop::scene::{Camera, Effect, EffectSet, Light, Scene};
use outcrop::source::DiskSource;
use outcrop::texture::Textures;
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

/// A square of `side` texels: colours without pattern, and a hole in every fourth square of 32.
fn write_image(path: &Path, side: u32, salt: u32, with_alpha: bool) {
    let mut bytes = Vec::new();
    for y in 0..side {
        for x in 0..side {
            let hash =
                (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503) ^ salt).wrapping_mul(2_246_822_519);
            let is_hole = with_alpha && (x / 32) % 2 == 1 && (y / 32) % 2 == 1;
            let [r, g, b, _] = hash.to_le_bytes();
            bytes.extend_from_slice(&[r / 2 + (x * 127 / side) as u8, g / 2 + (y * 127 / side) as u8, b]);
            if with_alpha {
                bytes.push(if is_hole { 0 } else { 255 });
            }
        }
    }
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), side, side);
    encoder.set_color(if with_alpha { png::ColorType::Rgba } else { png::ColorType::Rgb });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
}

/// A hilly ground with normals and coordinates that show a picture at every size, and cards above it.
fn write_model(folder: &Path) {
    use std::fmt::Write;
    let side = 40;
    let mut text = String::from("mtllib model.mtl\n");
    for i in 0..(side + 1) * (side + 1) {
        let (x, y) = (i % (side + 1), i / (side + 1));
        let height = (f64::from(x) * 0.7).sin() * (f64::from(y) * 0.5).cos();
        writeln!(
            text,
            "v {x} {height} {y}\nvt {} {}\nvn {} 2 {}",
            f64::from(x) / 4.0,
            f64::from(y) / 4.0,
            -0.7 * (f64::from(x) * 0.7).cos(),
            0.5 * (f64::from(y) * 0.5).sin()
        )
        .unwrap();
    }
    text.push_str("usemtl ground\n");
    for i in 0..side * side {
        let (x, y) = (i % side, i / side);
        let at = |dx: i32, dy: i32| (y + dy) * (side + 1) + x + dx + 1;
        let [a, b, c, d] = [at(0, 0), at(0, 1), at(1, 1), at(1, 0)];
        writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c} {d}/{d}/{d}").unwrap();
    }
    text.push_str("usemtl leaves\n");
    for card in 0..12 {
        let (x, z) = (f64::from(card * 7 % 36), f64::from(card * 11 % 33) + 2.0);
        writeln!(text, "v {x} 1 {z}\nv {} 1 {}\nv {} 5 {}\nv {x} 5 {z}", x + 4.0, z + 1.0, x + 4.0, z + 1.0)
            .unwrap();
        writeln!(text, "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf -4/-4 -3/-3 -2/-2 -1/-1").unwrap();
    }
    fs::write(folder.join("model.obj"), text).unwrap();
    let materials = "newmtl ground\nKd 0.9 0.9 0.9\nmap_Kd ground.png\nmap_Bump -bm 2 bumps.png\nnewmtl leaves\nKd 1 1 1\nmap_Kd leaves.png\n";
    fs::write(folder.join("model.mtl"), materials).unwrap();
    write_image(&folder.join("ground.png"), 1024, 1, false);
    write_image(&folder.join("bumps.png"), 256, 2, false);
    write_image(&folder.join("leaves.png"), 512, 3, true);
}

fn compiled(folder: &Path) -> Arc<DiskSource> {
    write_model(folder);
    let output = folder.join("model.outcrop");
    let options = CompileOptions { block_bytes: 8 << 10, codec: Codec::Lz4, ..CompileOptions::default() };
    let budget = MemoryBudget::new(Bytes::mib(64));
    let report =
        compile_file(folder.join("model.obj"), &output, &options, &budget, &mut |_| Control::Continue)
            .unwrap();
    assert_eq!(report.triangles_with_attributes, report.triangles);
    Arc::new(DiskSource::open(&output).unwrap())
}

fn scene() -> Scene {
    let camera = Camera::pinhole([20.0, 9.0, -12.0], [19.0, 0.0, 14.0], [0.0, 1.0, 0.0], 50.0).unwrap();
    Scene::new(camera)
        .with_background([0.5, 0.6, 0.8])
        .with_ambient([0.1; 3])
        .with_light(Light::directional([0.4, -1.0, 0.6], [0.8, 0.8, 0.7]))
}

fn textures(model: &Model, folder: &Path, budget: &MemoryBudget) -> Arc<Textures> {
    Textures::open(&model.materials, folder, &folder.join("model.tiles"), budget).unwrap()
}

/// Everything out of one budget, as a program does it.
fn render(
    source: &Arc<DiskSource>,
    folder: &Path,
    budget: Bytes,
    settings: &RenderSettings,
    threads: &Threads,
) -> (RenderedImage, [u64; 2]) {
    let budget = MemoryBudget::new(budget);
    let scene = scene().with_textures(textures(source.model(), folder, &budget));
    let needed = Renderer::bytes_needed(&scene, source.model(), settings, threads).unwrap();
    let aside = budget.reserve(needed, "the picture").unwrap();
    let tracers_max = match threads {
        Threads::Count(count) => *count as u32,
        _ => 1,
    };
    let options = OctreeOptions { tracers_max, ..OctreeOptions::default() };
    let octree = LazyOctree::open(Arc::clone(source) as Arc<dyn BlockSource>, &budget, options).unwrap();
    drop(aside);
    let renderer = Renderer::new(&octree, &scene, settings, &budget).unwrap();
    let image = renderer.render(threads, &mut |_| Control::Continue).unwrap();
    let (attributes, tiles) = (renderer.attribute_stats().unwrap(), renderer.texture_stats().unwrap());
    assert!(budget.peak() <= budget.limit());
    (image, [attributes.evictions, tiles.evictions])
}

#[test]
fn pictures_beyond_the_budget_render_inside_it_as_without_a_limit() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    let source = compiled(folder);
    let settings = RenderSettings { samples_per_pixel: 2, tile_size: 16, ..RenderSettings::new(96, 64) };
    let (reference, evictions) = render(&source, folder, Bytes::mib(256), &settings, &Threads::One);
    assert_eq!(evictions, [0, 0]);
    let effects = &reference.report.effects;
    assert!(
        effects.texture_reads > 3000 && effects.bump_reads > 3000 && effects.smooth_hits > 3000,
        "{effects:?}"
    );
    assert!(effects.cutouts_passed > 200, "{effects:?}");
    let tiles = fs::metadata(folder.join("model.tiles")).unwrap().len();
    for (mib, detail_bytes, threads) in
        [(6, 256 << 10, Threads::One), (12, 0, Threads::One), (12, 1 << 20, Threads::Count(3))]
    {
        let small = RenderSettings { detail_bytes, ..settings };
        let budget = Bytes::mib(mib);
        let (image, evictions) = render(&source, folder, budget, &small, &threads);
        assert!(detail_bytes < tiles / 4 && evictions[1] > 0, "{evictions:?}");
        assert!(image.film.pixels() == reference.film.pixels(), "{mib} MiB, {detail_bytes}");
        assert_eq!(image.report.effects, reference.report.effects);
    }
    // Nor do rays that wait for blocks.
    for (budget, threads) in [(Bytes::mib(24), Threads::One), (Bytes::mib(256), Threads::Count(2))] {
        let waiting =
            RenderSettings { waiting: WaitingRays::Count(500), detail_bytes: 256 << 10, ..settings };
        let (image, _) = render(&source, folder, budget, &waiting, &threads);
        assert!(image.film.pixels() == reference.film.pixels());
        assert_eq!(image.report.effects, reference.report.effects);
        assert!(image.report.waiting.is_some());
    }
    // Nor does the cut into blocks show, nor a forced effect.
    let forced = RenderSettings { forced: EffectSet::ALL, ..settings };
    let (image, _) = render(&source, folder, Bytes::mib(256), &forced, &Threads::One);
    assert!(image.film.pixels() == reference.film.pixels());
    for effect in [Effect::Textures, Effect::AlphaCutouts, Effect::BumpMaps, Effect::SmoothNormals] {
        let without = RenderSettings { switched_off: EffectSet::EMPTY.with(effect), ..settings };
        let (image, _) = render(&source, folder, Bytes::mib(256), &without, &Threads::One);
        assert!(image.film.pixels() != reference.film.pixels(), "{effect:?}");
    }
}

#[test]
fn what_is_missing_is_told_and_never_drawn_grey() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    let source = compiled(folder);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let octree = LazyOctree::open(
        Arc::clone(&source) as Arc<dyn BlockSource>,
        &budget,
        OctreeOptions { slots_max: Some(64), ..OctreeOptions::default() },
    )
    .unwrap();
    let settings = RenderSettings::new(8, 8);
    let refused = Renderer::new(&octree, &scene(), &settings, &budget).map(drop).unwrap_err();
    assert!(
        matches!(&refused, RenderError::Setting { what: "textures", reason } if reason.contains("ground.png")),
        "{refused}"
    );
    let images = [Effect::Textures, Effect::AlphaCutouts, Effect::BumpMaps];
    let off = RenderSettings { switched_off: images.into_iter().collect(), ..settings };
    let renderer = Renderer::new(&octree, &scene(), &off, &budget).unwrap();
    assert!(renderer.plan().has(Effect::SmoothNormals) && renderer.texture_stats().is_none());
    drop(renderer);
    // A tile that is damaged ends the render.
    let open = textures(source.model(), folder, &budget);
    drop(open);
    let tiles = folder.join("model.tiles");
    let mut bytes = fs::read(&tiles).unwrap();
    let end = bytes.len();
    for at in (64..end - 20_000).step_by(16_384) {
        bytes[at + 9] ^= 1;
    }
    fs::write(&tiles, bytes).unwrap();
    let scene = scene().with_textures(textures(source.model(), folder, &budget));
    let renderer = Renderer::new(&octree, &scene, &settings, &budget).unwrap();
    let error = renderer.render(&Threads::One, &mut |_| Control::Continue).map(drop).unwrap_err().to_string();
    assert!(error.contains("model.tiles is damaged"), "{error}");
}
