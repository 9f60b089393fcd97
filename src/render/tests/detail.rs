//! What hits look like by the attributes of their corners: smooth normals, pictures, holes, bumps.

use super::effects::{pictures, with_images};
use super::*;
use crate::model::{ImageMap, MaterialImages};
use crate::render::Film;
use crate::scene::{Effect, EffectSet, Light};
use crate::texture::{Encoding, ImageKey, PixelImage, Textures};

/// From the front, with a lamp far to the left of the camera.
fn lit_from_the_side() -> Scene {
    let camera = Camera::orthographic([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 2.2).unwrap();
    Scene::new(camera).with_light(Light::directional([1.0, 0.0, -0.1], [1.0; 3]))
}

fn settings() -> RenderSettings {
    RenderSettings::new(64, 64)
}

/// What a perfect white sphere shows, pixel by pixel, where the ray meets the mesh inscribed to it too.
fn differences(film: &Film, toward: [f64; 3]) -> (f64, f64) {
    let toward = DVec3::from_array(toward).normalize();
    let (mut sum, mut worst, mut count) = (0.0, 0.0f64, 0);
    for y in 0..64 {
        for x in 0..64 {
            let [px, py] =
                [(f64::from(x) + 0.5) / 32.0 - 1.0, 1.0 - (f64::from(y) + 0.5) / 32.0].map(|p| p * 1.1);
            let r2 = px * px + py * py;
            // Not at the rim, where the mesh ends before the sphere.
            if r2 > 0.75 {
                continue;
            }
            let normal = DVec3::new(px, py, (1.0 - r2).sqrt());
            let error = (f64::from(film.pixel(x, y)[0]) - normal.dot(toward).max(0.0)).abs();
            sum += error;
            worst = worst.max(error);
            count += 1;
        }
    }
    (sum / f64::from(count), worst)
}

#[test]
fn a_coarse_smooth_sphere_is_shaded_like_a_sphere_also_where_light_ends() {
    let scene = lit_from_the_side();
    let film = |is_smooth, switched_off| {
        let mesh = Mesh::new([matt(1.0)]).sphere(0, [0.0; 3], 1.0, 2, is_smooth);
        let settings = RenderSettings { switched_off, contribution_bound: 0.0, ..settings() };
        render(&mesh, &scene, &settings).film
    };
    let toward = [-1.0, 0.0, 0.1];
    let (flat, _) = differences(&film(false, EffectSet::EMPTY), toward);
    let (smooth, worst) = differences(&film(true, EffectSet::EMPTY), toward);
    let (unshadowed, _) = differences(&film(true, EffectSet::EMPTY.with(Effect::Shadows)), toward);
    // The interpolated normal is that of the sphere but for the mesh's lesser depth; the shadow of the mesh on itself adds nothing: without
    // the lift it takes light from a broad band.
    assert!(flat > 0.03 && smooth < 0.02 && worst < 0.12, "{flat} {smooth} {worst}");
    assert!((smooth - unshadowed).abs() < 0.002, "{smooth} {unshadowed}");
}

#[test]
fn flat_normals_change_no_bit() {
    // Normals that are those of the triangles are what there is without any.
    let corners = [
        [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]],
        [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
    ];
    let mesh = |attributes: CornerAttributes| {
        corners.iter().fold(Mesh::new([matt(0.8)]), |mesh, corners| mesh.triangle(0, *corners, attributes))
    };
    let scene = Scene::new(Camera::pinhole([0.5, 0.2, 3.0], [0.0; 3], [0.0, 1.0, 0.0], 50.0).unwrap())
        .with_light(Light::point([1.0, 2.0, 2.0], [1.0; 3]));
    let with = CornerAttributes { normals: Some([[0.0, 0.0, 1.0]; 3]), uvs: None };
    let [plain, smooth] =
        [CornerAttributes::default(), with].map(|attributes| render(&mesh(attributes), &scene, &settings()));
    assert_eq!(plain.totals.effects.attribute_lookups, 0);
    assert!(smooth.totals.effects.smooth_hits > 500);
    assert!(plain.film.pixels() == smooth.film.pixels());
}

#[test]
fn normals_from_behind_and_across_never_give_more_than_the_light() {
    // Every normal that a file can hold: no pixel is brighter than a facing surface, none is NaN.
    let scene = lit_from_the_side()
        .with_light(Light::directional([0.0, 0.0, -1.0], [0.5; 3]))
        .with_interreflection()
        .with_background([0.2; 3]);
    let directions =
        [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 1e-9], [0.6, 0.0, -0.8], [0.0; 3]];
    for a in directions {
        for b in directions {
            let attributes = CornerAttributes { normals: Some([a, b, a]), uvs: None };
            for material in [matt(0.5), mirror(0.9), clear(1.5)] {
                let mesh = Mesh::new([material]).triangle(
                    0,
                    [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.3], [0.0, 1.0, 0.0]],
                    attributes,
                );
                let film = render(&mesh, &scene, &RenderSettings::new(16, 16)).film;
                for pixel in film.pixels() {
                    assert!(pixel.iter().all(|x| (0.0..1.6).contains(x)), "{a:?} {b:?}: {pixel:?}");
                }
            }
        }
    }
}

fn diffuse(name: &str) -> MaterialImages {
    MaterialImages { diffuse: Some(ImageMap::new(name)), ..MaterialImages::default() }
}

/// One picture by this name, of `width` x `height` texels.
fn picture(
    name: &str,
    encoding: Encoding,
    width: u32,
    height: u32,
    texel: impl Fn(u32, u32) -> [u8; 4],
) -> Arc<Textures> {
    let texels = (0..width * height).map(|index| texel(index % width, index / width)).collect();
    Textures::in_memory([(ImageKey { path: name.into(), encoding }, PixelImage { width, height, texels })])
        .unwrap()
}

/// A square that fills the picture of the straight camera, lit by ambient light alone.
fn wall(material: MaterialRecord) -> Mesh {
    Mesh::new([material]).card(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0)
}

fn ambient() -> Scene {
    Scene::new(straight_camera()).with_ambient([1.0; 3])
}

#[test]
fn a_picture_lies_on_the_surface_as_it_should() {
    // Sixteen texels of their own colour: one pixel each.
    let texel = |x: u32, y: u32| [(x * 60) as u8, (y * 60) as u8, 128, 255];
    let scene = ambient().with_textures(picture("a", Encoding::Srgb, 4, 4, texel));
    let mesh = wall(with_images(matt(0.5), diffuse("a")));
    let settings = RenderSettings { contribution_bound: 0.0, ..RenderSettings::new(4, 4) };
    let found = render(&mesh, &scene, &settings);
    let linear = |byte: u8| {
        let x = f64::from(byte) / 255.0;
        if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    };
    for y in 0..4 {
        for x in 0..4 {
            // Rows of pictures and of image files both run from the top; `Kd` multiplies.
            let [r, g, b, _] = texel(x, y).map(linear);
            assert_close(found.film.pixel(x, y), [r, g, b].map(|channel| 0.5 * channel), 1e-6);
        }
    }
    // Turned over and doubled by the options of the map.
    let map = ImageMap { scale: [2.0, -1.0], offset: [0.0, 1.0], ..ImageMap::new("a") };
    let images = MaterialImages { diffuse: Some(map), ..MaterialImages::default() };
    let turned = render(&wall(with_images(matt(0.5), images)), &scene, &settings).film;
    // Two texels share a pixel across: the size that is one half.
    assert!(turned.pixel(0, 0) == turned.pixel(2, 0) && turned.pixel(0, 0) != turned.pixel(1, 0));
    assert!(turned.pixel(0, 0)[1] > turned.pixel(0, 3)[1]);
}

#[test]
fn from_afar_a_picture_is_its_mean() {
    // Half black, half white in stripes finer than a pixel: grey, without a moire, from one sample.
    let stripes = picture("a", Encoding::Srgb, 256, 256, |x, _| {
        let v = if x % 2 == 0 { 0 } else { 255 };
        [v, v, v, 255]
    });
    let mesh = wall(with_images(matt(1.0), diffuse("a")));
    let scene = ambient().with_textures(stripes);
    let settings = RenderSettings { contribution_bound: 0.0, ..RenderSettings::new(8, 8) };
    for pixel in render(&mesh, &scene, &settings).film.pixels() {
        assert_close(*pixel, [0.5; 3], 0.01);
    }
    // Seen close, each stripe is black or white.
    let close = Scene::new(
        Camera::orthographic([0.001, 0.001, 5.0], [0.001, 0.001, 0.0], [0.0, 1.0, 0.0], 0.01).unwrap(),
    );
    let close = close.with_ambient([1.0; 3]).with_textures(Arc::clone(scene.textures().unwrap()));
    let film = render(&mesh, &close, &RenderSettings::new(64, 4)).film;
    let extremes = film.pixels().iter().filter(|pixel| pixel[0] < 0.2 || pixel[0] > 0.8).count();
    assert!(extremes > film.pixels().len() / 4, "{extremes}");
}

#[test]
fn seams_of_a_repeated_picture_do_not_show() {
    // A picture that goes on across its border, on two cards whose coordinates meet at a whole number.
    let smooth = |x: u32, y: u32| {
        let wave = |at: u32| 127.5 + 100.0 * (f64::from(at) / 128.0 * std::f64::consts::TAU).sin();
        [wave(x) as u8, wave(y) as u8, 90, 255]
    };
    let scene = ambient().with_textures(picture("a", Encoding::Srgb, 128, 128, smooth));
    let mesh = Mesh::new([with_images(matt(1.0), diffuse("a"))])
        .card(0, [-1.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0)
        .card(0, [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0);
    let film = render(&mesh, &scene, &RenderSettings::new(64, 64)).film;
    let step = |x: u32, y: u32| (film.pixel(x + 1, y)[0] - film.pixel(x, y)[0]).abs();
    for y in 0..64 {
        let inside = (8..24).map(|x| step(x, y)).fold(0.0f32, f32::max);
        assert!(step(31, y) <= 2.0 * inside + 0.01, "{y}: {} {inside}", step(31, y));
    }
}

#[test]
fn rays_of_every_kind_pass_what_is_cut_out() {
    // A wall with a hole before a glowing one; light from behind the camera throws the hole's shape onto a third.
    let hole = picture("a", Encoding::Linear, 2, 1, |x, _| if x == 0 { [0, 0, 0, 255] } else { [255; 4] });
    let images = MaterialImages {
        opacity: Some(ImageMap { clamp: true, ..ImageMap::new("a") }),
        ..MaterialImages::default()
    };
    let glowing = MaterialRecord { emission: [1.0, 0.0, 0.0], ..matt(0.0) };
    let front = with_images(matt(0.0), images);
    let mesh = |front: MaterialRecord| {
        Mesh::new([front, glowing.clone()])
            .card(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0)
            .card(0, [-1.0, -1.0, -0.5], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0)
            .sheet(1, [-1.0, -1.0, -1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0])
    };
    let scene = ambient().with_textures(Arc::clone(&hole));
    let settings = RenderSettings::new(8, 8);
    let found = render(&mesh(front.clone()), &scene, &settings);
    for y in 0..8 {
        for x in 0..8 {
            assert_eq!(found.film.pixel(x, y)[0] > 0.5, x < 4, "{x}");
        }
    }
    // Two holes for each of the rays on the left, and twice where a ray meets the edge between two triangles; none twice.
    let effects = &found.totals.effects;
    assert!((64..=72).contains(&effects.cutouts_passed), "{effects:?}");
    assert_eq!(effects.cutout_rays, effects.cutouts_passed);
    assert_eq!(effects.cutout_tests, effects.cutouts_passed + 32);
    // Shadows: light through the hole, and where it is not.
    let lit = Mesh::new([front, matt(1.0)])
        .card(0, [-1.0, -1.0, 1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0)
        .sheet(1, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    // From below the card, so that only shadow rays meet it.
    let camera = Camera::orthographic([0.0, 0.0, 0.5], [0.0; 3], [0.0, 1.0, 0.0], 2.0).unwrap();
    let scene =
        Scene::new(camera).with_light(Light::directional([0.0, 0.0, -1.0], [1.0; 3])).with_textures(hole);
    let film = render(&lit, &scene, &settings).film;
    for y in 0..8 {
        for x in 0..8 {
            assert_eq!(film.pixel(x, y)[0] > 0.5, x < 4, "{x}");
        }
    }
}

#[test]
fn alpha_exactly_at_the_threshold_is_there() {
    // Bytes 127 and 128 lie around one half; between 0 and 255 the linear filter gives one half exactly in the middle.
    let scene = |left: u8, right: u8| {
        let texel = move |x: u32, _| [0, 0, 0, if x == 0 { left } else { right }];
        ambient().with_textures(picture("a", Encoding::Srgb, 2, 1, texel))
    };
    let map = ImageMap { clamp: true, ..ImageMap::new("a") };
    let images = MaterialImages { diffuse: Some(map), ..MaterialImages::default() };
    let mesh = wall(with_images(matt(1.0), images));
    // Pixels that show what is behind.
    let holes = |scene: Scene, side| {
        let scene = scene.with_background([1.0, 0.0, 0.0]);
        let film = render(&mesh, &scene, &RenderSettings::new(side, side)).film;
        film.pixels().iter().map(|pixel| u8::from(pixel[0] > 0.5)).collect::<Vec<_>>()
    };
    assert_eq!(holes(scene(127, 127), 4), [1; 16]);
    assert_eq!(holes(scene(128, 128), 4), [0; 16]);
    // Three columns: the middle ray meets the picture's middle, where alpha is one half; it is there, as is all to the right.
    assert_eq!(holes(scene(0, 255), 3), [1, 0, 0, 1, 0, 0, 1, 0, 0]);
}

#[test]
fn bumps_turn_to_the_light_and_flat_pictures_change_nothing() {
    let flat = picture("a", Encoding::Linear, 4, 4, |_, _| [128, 128, 255, 255]);
    let images = |map: ImageMap, is_normal| match is_normal {
        true => MaterialImages { normal: Some(map), ..MaterialImages::default() },
        false => MaterialImages { bump: Some(map), ..MaterialImages::default() },
    };
    let light = |toward: [f64; 3]| Light::directional(toward.map(|x| -x), [1.0; 3]);
    let scene = |toward, textures: &Arc<Textures>| {
        Scene::new(straight_camera()).with_light(light(toward)).with_textures(Arc::clone(textures))
    };
    let settings = RenderSettings { contribution_bound: 0.0, ..RenderSettings::new(4, 4) };
    let plain = render(&wall(matt(1.0)), &scene([0.0, 0.6, 0.8], &flat), &settings).film;
    let bumped = wall(with_images(matt(1.0), images(ImageMap::new("a"), false)));
    assert!(render(&bumped, &scene([0.0, 0.6, 0.8], &flat), &settings).film.pixels() == plain.pixels());
    let normals = wall(with_images(matt(1.0), images(ImageMap::new("a"), true)));
    for pixel in render(&normals, &scene([0.0, 0.6, 0.8], &flat), &settings).film.pixels() {
        // 128 of 255 is not quite the middle.
        assert_close(*pixel, [0.8; 3], 0.005);
    }
    // A ramp that rises to the right faces left; a normal map that says right faces right; on the back of the wall likewise.
    let ramp = picture("a", Encoding::Linear, 64, 4, |x, _| [(x * 4) as u8, 0, 0, 255]);
    let right = picture("a", Encoding::Linear, 4, 4, |_, _| [218, 128, 218, 255]);
    let brightness = |mesh: &Mesh, toward, textures| {
        let film = render(mesh, &scene(toward, textures), &settings).film;
        f64::from(film.pixel(1, 1)[0])
    };
    let steep =
        wall(with_images(matt(1.0), images(ImageMap { strength: 30.0, ..ImageMap::new("a") }, false)));
    let (from_left, from_right) = ([-0.6, 0.0, 0.8], [0.6, 0.0, 0.8]);
    assert!(brightness(&steep, from_left, &ramp) > brightness(&steep, from_right, &ramp) + 0.2);
    // A picture that is laid on turned around rises to the left; seen once across the wall, it is the same ramp.
    let map = ImageMap { strength: 30.0, scale: [-1.0, 1.0], offset: [1.0, 0.0], ..ImageMap::new("a") };
    let turned = wall(with_images(matt(1.0), images(map, false)));
    assert!(brightness(&turned, from_right, &ramp) > brightness(&turned, from_left, &ramp) + 0.2);
    assert!(brightness(&normals, from_right, &right) > brightness(&normals, from_left, &right) + 0.5);
    assert!((brightness(&normals, [0.6, 0.0, 0.8], &right) - 0.707 * 1.4).abs() < 0.02);
}

#[test]
fn pictures_that_are_not_open_are_an_error_not_a_grey_surface() {
    let scene = ambient();
    let materials = [with_images(matt(0.5), diffuse("chequer"))];
    let error = scene.validate_textures(&materials, EffectSet::EMPTY).unwrap_err().to_string();
    assert!(error.contains("chequer") && error.contains("with_textures"), "{error}");
    let off = EffectSet::EMPTY.with(Effect::Textures).with(Effect::AlphaCutouts);
    scene.validate_textures(&materials, off).unwrap();
    scene.with_textures(pictures()).validate_textures(&materials, EffectSet::EMPTY).unwrap();
}
