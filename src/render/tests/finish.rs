//! Pictures of roughness, metalness and emission: texel by texel what numbers would be, to the bit.

use super::effects::{metal, panel, with_images};
use super::*;
use crate::model::{ImageMap, MaterialImages};
use crate::render::EffectCounters;
use crate::scene::{Effect, EffectSet, Environment, Finish, Light, Surface};
use crate::texture::{Encoding, ImageKey, PixelImage, Textures};

/// A picture named `finish` of 64 x 64 texels, once as numbers and once as colours.
fn picture(texel: impl Fn(u32, u32) -> [u8; 4]) -> Arc<Textures> {
    let texels: Vec<_> = (0..64 * 64).map(|index| texel(index % 64, index / 64)).collect();
    let image = PixelImage { width: 64, height: 64, texels };
    let key = |encoding| ImageKey { path: "finish".into(), encoding };
    Textures::in_memory([
        (key(Encoding::Linear), image.clone()),
        (key(Encoding::Srgb), PixelImage { width: 64, height: 64, texels: image.texels }),
    ])
    .unwrap()
}

fn images() -> MaterialImages {
    let map = || Some(ImageMap::new("finish"));
    MaterialImages { roughness: map(), metalness: map(), ..MaterialImages::default() }
}

/// The number that a byte stands for.
fn share(byte: u8) -> f32 {
    (f64::from(byte) / 255.0) as f32
}

/// A ground, a card of this material that shows a quarter of a picture, and a box beside it.
fn still(material: MaterialRecord) -> Mesh {
    Mesh::new([matt(0.6), material, matt(0.3)])
        .sheet(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0])
        .card(1, [-1.5, -1.0, -0.5], [3.0, 0.0, 0.3], [0.0, 2.0, 0.0], 0.25)
        .cuboid(2, [0.2, -1.0, 0.3], [0.8, -0.2, 0.9])
}

fn sun() -> Scene {
    Scene::new(Camera::pinhole([1.0, 1.5, 6.0], [0.0; 3], [0.0, 1.0, 0.0], 35.0).unwrap())
        .with_background([0.3, 0.4, 0.6])
        .with_ambient([0.05; 3])
        .with_light(Light::directional([0.3, -0.5, -1.0], [0.5, 0.45, 0.4]))
}

/// Under every kind of light.
fn scenes() -> Vec<Scene> {
    let sky = Environment::Constant([0.5, 0.6, 0.7]);
    vec![
        sun(),
        sun().with_light(panel()),
        sun().with_light(panel()).with_environment(sky).with_interreflection(),
    ]
}

fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 2, work_budget: 64, ..RenderSettings::new(14, 11) }
}

/// Materials whose roughness or metalness shows: metal, paint, both, and a pane.
fn materials() -> Vec<MaterialRecord> {
    let paint = MaterialRecord { metalness: 0.0, ..metal(0.7) };
    let pane = MaterialRecord { opacity: 0.25, refractive_index: 1.5, ..paint.clone() };
    let half = MaterialRecord { metalness: 0.5, roughness: 0.5, ..metal(0.7) };
    let gilt_pane = MaterialRecord { metalness: 1.0, ..pane.clone() };
    vec![metal(0.7), paint, pane, half, gilt_pane]
}

/// What was done, reads of pictures apart.
fn work(counters: &EffectCounters) -> EffectCounters {
    EffectCounters { finish_reads: 0, attribute_lookups: 0, texture_reads: 0, ..*counters }
}

/// A picture of one texel looks as its numbers, with the counters and cuts of these: nothing is followed for what it might have been.
#[test]
fn a_picture_of_one_texel_looks_as_its_numbers() {
    for scene in scenes() {
        for record in materials() {
            for [roughness, metalness] in
                [[128, 255], [0, 255], [77, 0], [51, 100], [255, 255], [0, 0], [0, 9]]
            {
                let numbers = MaterialRecord {
                    roughness: record.roughness * share(roughness),
                    metalness: record.metalness * share(metalness),
                    ..record.clone()
                };
                let context = format!("{roughness} {metalness} {record:?}");
                let by_numbers = render(&still(numbers), &scene, &settings());
                let pictured = scene.clone().with_textures(picture(|_, _| [7, roughness, metalness, 255]));
                let mesh = still(with_images(record.clone(), images()));
                let by_picture = render(&mesh, &pictured, &settings());
                assert!(by_numbers.film.pixels() == by_picture.film.pixels(), "{context}");
                let (numbers, found) = (&by_numbers.totals.effects, &by_picture.totals.effects);
                assert_eq!(work(numbers), work(found), "{context}");
                assert!(found.finish_reads > 0 && numbers.finish_reads == 0, "{context}");
                let forced = RenderSettings { forced: EffectSet::ALL, ..settings() };
                let forced = render(&mesh, &pictured, &forced);
                assert!(by_picture.film.pixels() == forced.film.pixels(), "{context}");
            }
        }
    }
}

/// Where other parts of the picture have other numbers, bounds are wider, and that is all.
#[test]
fn a_part_of_a_picture_looks_as_its_numbers_where_nothing_is_cut() {
    let settings = RenderSettings { contribution_bound: 0.0, work_budget: 16, ..settings() };
    for scene in scenes().into_iter().filter(|scene| !scene.has_interreflection()) {
        for record in materials() {
            let numbers = MaterialRecord {
                roughness: record.roughness * share(128),
                metalness: record.metalness * share(200),
                ..record.clone()
            };
            // The card shows part of this, and camera rays alone look at it.
            let is_shown = |x: u32, y: u32| x < 40 && y >= 24;
            let textures = picture(|x, y| if is_shown(x, y) { [0, 128, 200, 255] } else { [0, 0, 255, 255] });
            let by_numbers = render(&still(numbers), &scene, &settings);
            let map = || Some(ImageMap { offset: [0.125, 0.125], ..ImageMap::new("finish") });
            let images = MaterialImages { roughness: map(), metalness: map(), ..MaterialImages::default() };
            let mesh = still(with_images(record.clone(), images));
            let by_picture = render(&mesh, &scene.clone().with_textures(textures), &settings);
            assert!(by_numbers.film.pixels() == by_picture.film.pixels(), "{record:?}");
        }
    }
}

/// Light that comes to the ground through a pane of which a half is gilt.
#[test]
fn shadows_of_a_pane_are_those_of_its_texels() {
    let textures = picture(|x, _| [0, 0, if x < 32 { 255 } else { 0 }, 255]);
    let settings = RenderSettings { contribution_bound: 0.0, ..RenderSettings::new(1, 1) };
    for refractive_index in [1.0, 1.5] {
        let pane = MaterialRecord { opacity: 0.25, refractive_index, roughness: 0.0, ..metal(0.7) };
        let under = |x: f64, material: MaterialRecord| {
            let mesh = Mesh::new([matt(0.6), material])
                .sheet(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0])
                .card(1, [-2.0, 1.0, -2.0], [4.0, 0.0, 0.0], [0.0, 0.0, 4.0], 1.0);
            // From between the two, at the ground.
            let camera = Camera::pinhole([x, 0.5, 0.01], [x, -1.0, 0.0], [0.0, 0.0, 1.0], 1.0).unwrap();
            let scene = Scene::new(camera)
                .with_light(Light::directional([0.01, -1.0, 0.02], [0.5; 3]))
                .with_textures(Arc::clone(&textures));
            one_pixel(&mesh, &scene, &settings)
        };
        let metalness = || Some(ImageMap::new("finish"));
        let pictured =
            with_images(pane.clone(), MaterialImages { metalness: metalness(), ..MaterialImages::default() });
        let mut seen = Vec::new();
        for (x, metalness) in [(-1.0, 1.0), (1.0, 0.0)] {
            let (by_numbers, _) = under(x, MaterialRecord { metalness, ..pane.clone() });
            let (by_picture, counted) = under(x, pictured.clone());
            assert_eq!(by_picture, by_numbers, "{x}");
            let effects = &counted.totals.effects;
            assert!(effects.shadow_segments > 0, "{x}: {effects:?}");
            // What does not refract passes as much where it is metal.
            assert_eq!(effects.finish_reads > 0, refractive_index != 1.0, "{x}: {effects:?}");
            seen.push(by_picture);
        }
        if refractive_index == 1.5 {
            assert!(seen[0][0] < 0.1 * seen[1][0], "metal lets nothing through: {seen:?}");
        }
    }
}

/// As much of each as the texel says, of numbers that can be worked out by hand.
#[test]
fn metalness_mixes_by_texel() {
    let textures = picture(|_, _| [0, 0, 51, 255]);
    let scene = Scene::new(straight_camera()).with_ambient([0.5; 3]).with_background([0.25, 0.5, 1.0]);
    let record = MaterialRecord { diffuse: [0.8, 0.4, 0.2], specular: [0.0; 3], ..metal(0.0) };
    let mesh = Mesh::new([with_images(record.clone(), images())]);
    let mesh = mesh.card(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0);
    let (color, picture) =
        one_pixel(&mesh, &scene.clone().with_textures(Arc::clone(&textures)), &RenderSettings::new(1, 1));
    let expected = [0, 1, 2].map(|channel| {
        let base = f64::from(record.diffuse[channel]);
        base * (0.8 * 0.5 + 0.2 * [0.25, 0.5, 1.0][channel])
    });
    assert_close(color, expected, 1e-6);
    // One lookup for both, as they are in one image.
    assert_eq!((picture.totals.effects.finish_reads, picture.totals.effects.reflection_rays), (1, 1));
    // Without the effect it is metal all over.
    let off = RenderSettings {
        switched_off: EffectSet::EMPTY.with(Effect::FinishMaps),
        ..RenderSettings::new(1, 1)
    };
    let scene = scene.with_finish("", Finish::rough(0.0)).with_textures(textures);
    let (color, picture) = one_pixel(&mesh, &scene, &off);
    assert_close(color, [0.2, 0.2, 0.2], 1e-6);
    assert_eq!(picture.totals.effects.finish_reads, 0);
}

/// Triangles without texture coordinates take the mean of the picture.
#[test]
fn without_coordinates_the_mean_counts() {
    let scene = Scene::new(straight_camera()).with_ambient([1.0; 3]);
    let record = MaterialRecord { specular: [0.0; 3], ..metal(0.5) };
    let mesh = Mesh::new([with_images(record.clone(), images())])
        .card(0, [7.0, 7.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1.0)
        .sheet(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    let textures = picture(|x, _| [0, 128, if x < 16 { 255 } else { 0 }, 255]);
    let (color, _) = one_pixel(&mesh, &scene.with_textures(textures), &RenderSettings::new(1, 1));
    // A quarter mirrors a black world.
    assert_close(color, [0.5 * 0.75; 3], 2e-3);
}

#[test]
fn a_finish_of_the_scene_overrides_the_picture_of_roughness() {
    let record = MaterialRecord { name: "gold".to_string(), ..metal(0.8) };
    let scene = sun().with_finish("gold", Finish::rough(0.25));
    let plain = MaterialRecord { roughness: 0.25, ..record.clone() };
    let by_numbers = render(&still(plain), &sun(), &settings());
    let map = MaterialImages { roughness: images().roughness, ..MaterialImages::default() };
    let mesh = still(with_images(record, map));
    let textures = picture(|x, _| [0, 4 * x as u8, 0, 255]);
    let picture = render(&mesh, &scene.with_textures(textures), &settings());
    assert!(by_numbers.film.pixels() == picture.film.pixels());
    assert_eq!(picture.totals.effects.finish_reads, 0);
}

#[test]
fn what_glows_glows_by_its_picture() {
    let glow = MaterialImages { emission: Some(ImageMap::new("finish")), ..MaterialImages::default() };
    let record = |emission| MaterialRecord { emission, ..matt(0.5) };
    for scene in scenes() {
        let numbers = render(&still(record([0.75, 0.0, 0.5])), &scene, &settings());
        let pictured = scene.clone().with_textures(picture(|_, _| [255, 0, 255, 255]));
        let mesh = still(with_images(record([0.75, 4.0, 0.5]), glow.clone()));
        // The bound on what a ray brings back is that of the factor.
        let exact = RenderSettings { contribution_bound: 0.0, work_budget: 16, ..settings() };
        let by_numbers = render(&still(record([0.75, 0.0, 0.5])), &scene, &exact);
        let by_picture = render(&mesh, &pictured, &exact);
        assert!(by_numbers.film.pixels() == by_picture.film.pixels());
        assert_eq!(work(&by_numbers.totals.effects), work(&by_picture.totals.effects));
        assert!(by_picture.totals.effects.texture_reads > 0);
        // Where the picture is black nothing glows; without emission it is not looked up.
        let black = scene.clone().with_textures(picture(|_, _| [0, 0, 0, 255]));
        let dark = render(&mesh, &black, &settings()).totals.effects;
        assert_eq!(dark.glowing_hits, 0);
        let off = RenderSettings { switched_off: EffectSet::EMPTY.with(Effect::Emission), ..settings() };
        let off = render(&mesh, &pictured, &off);
        assert_eq!((off.totals.effects.texture_reads, off.totals.effects.glowing_hits), (0, 0));
        assert!(off.film.pixels() != numbers.film.pixels());
    }
}

/// White metal and white paint in a white world, as rough as a picture says: they lose what meets a second facet, and gain nothing.
#[test]
fn white_furnace_of_pictures() {
    let camera = Camera::pinhole([3.0, 2.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 30.0).unwrap();
    let card = |record: MaterialRecord| {
        Mesh::new([record]).card(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.5], [0.0, 2.0, 0.0], 1.0)
    };
    let settings =
        RenderSettings { samples_per_pixel: 256, contribution_bound: 1e-5, ..RenderSettings::new(4, 4) };
    let mean = |record: MaterialRecord, textures: Option<Arc<Textures>>, is_sampled: bool| {
        let scene = Scene::new(camera).with_interreflection();
        let scene = match is_sampled {
            true => scene.with_environment(Environment::Constant([1.0; 3])),
            false => scene.with_background([1.0; 3]),
        };
        let scene = match textures {
            Some(textures) => scene.with_textures(textures),
            None => scene,
        };
        let film = render(&card(record), &scene, &settings).film;
        film.pixels().iter().map(|pixel| pixel[0]).sum::<f32>() / film.pixels().len() as f32
    };
    let white = MaterialRecord { specular: [0.0; 3], ..metal(1.0) };
    for is_sampled in [false, true] {
        // From smooth to as rough as can be, and from paint to metal.
        let varied = picture(|x, y| [0, 4 * x as u8, 4 * y as u8, 255]);
        let found = mean(with_images(white.clone(), images()), Some(varied), is_sampled);
        assert!(found < 1.005 && found > 0.85, "{is_sampled}: {found}");
        // A uniform one, by its picture and by its number.
        let half = picture(|_, _| [0, 128, 255, 255]);
        let by_picture = mean(with_images(white.clone(), images()), Some(half), is_sampled);
        let by_number = MaterialRecord { roughness: share(128), ..white.clone() };
        assert_eq!(by_picture, mean(by_number, None, is_sampled));
        assert!(by_picture < 1.005 && by_picture > 0.9, "{is_sampled}: {by_picture}");
    }
}

/// A smooth mirror has the highlight of a lamp, whether something else is rough or not.
#[test]
fn a_smooth_mirror_keeps_its_highlight_beside_a_rough_one() {
    let smooth = MaterialRecord { shininess: 8.0, ..mirror(0.5) };
    let scene = Scene::new(straight_camera()).with_light(Light::directional([0.0, 0.0, -1.0], [1.0; 3]));
    let mesh = |record| {
        Mesh::new([smooth.clone(), record])
            .sheet(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0])
            .sheet(1, [7.0, 7.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    };
    let settings = RenderSettings::new(1, 1);
    let alone = one_pixel(&mesh(smooth.clone()), &scene, &settings).0;
    let beside = one_pixel(&mesh(MaterialRecord { roughness: 0.5, ..smooth.clone() }), &scene, &settings).0;
    assert_eq!((alone, beside), ([0.5; 3], [0.5; 3]));
}

/// No place of a picture has terms beyond those of the ends.
#[test]
fn ends_hold_whatever_a_picture_says() {
    let channel_max = |color: [f64; 3]| color.into_iter().fold(0.0, f64::max);
    let scene = sun().with_light(panel()).with_interreflection();
    // Some of each, and from nothing to nearly all.
    let some = picture(|x, y| [0, 3 * x as u8 + 40, 2 * y as u8 + 100, 255]);
    let whole = picture(|x, y| [0, 4 * x as u8, 4 * y as u8, 255]);
    let cases = [(some, [40, 229], [100, 226]), (whole, [0, 252], [0, 252])];
    let off = [
        EffectSet::EMPTY,
        EffectSet::EMPTY.with(Effect::RoughRefraction),
        EffectSet::EMPTY.with(Effect::GlossyReflection),
        EffectSet::EMPTY.with(Effect::Reflection),
        EffectSet::EMPTY.with(Effect::Transmission),
    ];
    let mut seen = 0;
    for (record, ((textures, greens, blues), switched_off)) in materials()
        .into_iter()
        .flat_map(|record| cases.iter().map(move |case| (record.clone(), case)))
        .flat_map(|(record, case)| off.into_iter().map(move |off| (record.clone(), (case, off))))
    {
        let scene = scene.clone().with_textures(Arc::clone(textures));
        let record = with_images(record, images());
        let kinds = AttributeKinds { uvs: true, normals: false };
        let options = RenderSettings { switched_off, ..settings() }.effect_options();
        let plan = EffectPlan::of_parts(&scene, [&record], kinds, &options);
        assert!(plan.has(Effect::FinishMaps), "{}", plan.explain());
        let ends = plan.ends(&scene, &record);
        let most = |term: &dyn Fn(&Surface) -> f64| ends.iter().map(term).fold(0.0, f64::max);
        let sharpest = ends.iter().map(|end| end.alpha).filter(|alpha| *alpha > 0.0).fold(1.0, f64::min);
        let mixture = plan.mixture(&scene, &record);
        let steps = |[from, to]: [u8; 2]| (from..=to).step_by(9);
        for (green, blue) in steps(*greens).flat_map(|green| steps(*blues).map(move |blue| (green, blue))) {
            let terms = mixture.at(&crate::scene::Look {
                roughness: mixture.roughness * f64::from(share(green)),
                metalness: mixture.metalness * f64::from(share(blue)),
                ..mixture.factors()
            });
            let sent_on = |diffuse: [f64; 3], mirror: [f64; 3], transmission: f64| {
                channel_max([0, 1, 2].map(|channel| diffuse[channel] + mirror[channel])) + transmission
            };
            let rho = sent_on(terms.diffuse.to_array(), terms.mirror.to_array(), terms.transmission);
            assert!(rho <= 1.0 + 1e-12, "{rho}");
            let bound = most(&|end| sent_on(end.diffuse, end.mirror, end.transmission));
            assert!(rho <= bound + 1e-12, "{rho} {bound}");
            assert!(terms.alpha == 0.0 || terms.alpha >= sharpest, "{} {sharpest}", terms.alpha);
            let highlight = channel_max(terms.highlight.to_array());
            assert!(highlight <= most(&|end| channel_max(end.highlight)) + 1e-12);
            // No lobe of an effect that is off, and none that no end has for the same way of light.
            let is_glass = record.refractive_index != 1.0 && terms.transmission > 0.0;
            if terms.alpha > 0.0 && is_glass {
                assert!(!switched_off.contains(Effect::RoughRefraction), "{record:?}");
                assert!(ends.iter().any(|end| end.alpha > 0.0 && end.transmission > 0.0), "{record:?}");
            }
            if terms.alpha > 0.0 && terms.mirror != glam::DVec3::ZERO {
                assert!(!switched_off.contains(Effect::GlossyReflection), "{record:?}");
                assert!(ends.iter().any(|end| end.alpha > 0.0 && end.is_mirror()), "{record:?}");
            }
            seen += 1;
        }
    }
    assert!(seen > 10_000, "{seen}");
}

/// A picture of what is no metal leaves the metal its colour.
#[test]
fn a_picture_of_highlights_does_not_tint_metal() {
    let textures = picture(|_, _| [25, 25, 25, 255]);
    let map = MaterialImages { specular: Some(ImageMap::new("finish")), ..MaterialImages::default() };
    for scene in scenes() {
        let plain = render(&still(metal(0.5)), &scene, &settings());
        let scene = scene.with_textures(Arc::clone(&textures));
        let with_picture = render(&still(with_images(metal(0.5), map.clone())), &scene, &settings());
        assert!(plain.film.pixels() == with_picture.film.pixels());
        assert!(with_picture.totals.effects.texture_reads > 0);
    }
}

/// Where nothing depends on what a picture says, it is not looked at.
#[test]
fn pictures_that_change_nothing_are_not_needed() {
    let textures = picture(|x, y| [0, 4 * x as u8, 4 * y as u8, 255]);
    let map = || Some(ImageMap::new("finish"));
    let rough_only = MaterialImages { roughness: map(), ..MaterialImages::default() };
    let mirror = MaterialRecord { mirror: true, specular: [0.5; 3], roughness: 0.5, ..matt(0.2) };
    let paint = MaterialRecord { metalness: 0.0, exponent_by_roughness: true, ..metal(0.7) };
    let kinds = AttributeKinds { uvs: true, normals: false };
    for (record, off, is_needed) in [
        (&mirror, EffectSet::EMPTY, true),
        (&mirror, EffectSet::EMPTY.with(Effect::GlossyReflection), false),
        (&mirror, EffectSet::EMPTY.with(Effect::Reflection), false),
        (&paint, EffectSet::EMPTY, true),
        (&paint, EffectSet::EMPTY.with(Effect::DirectLight), false),
    ] {
        let record = with_images(record.clone(), rough_only.clone());
        let scene = sun().with_textures(Arc::clone(&textures));
        let options = RenderSettings { switched_off: off, ..settings() }.effect_options();
        let plan = EffectPlan::of_parts(&scene, [&record], kinds, &options);
        assert_eq!(plan.has(Effect::FinishMaps), is_needed, "{record:?}\n{}", plan.explain());
        assert_eq!(plan.variation(&scene, &record).is_any(), is_needed);
    }
}
