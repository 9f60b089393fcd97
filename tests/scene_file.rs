//! Scene files: every key that `docs/scene-file.md` names is read, everything else is an error that says where it is.

use std::path::Path;

use outcrop::MemoryBudget;
use outcrop::error::SceneFileError;
use outcrop::geom::{Aabb, Affine};
use outcrop::instance::Instance;
use outcrop::model::MaterialRecord;
use outcrop::render::{AdaptiveSampling, Filter, PathEnd, RenderSettings};
use outcrop::scene::{
    Camera, Environment, EnvironmentImage, Falloff, Finish, Lens, Light, LightShape, Projection, Scene,
};
use outcrop::scene_file::{Place, SceneFile};
use outcrop::units::Bytes;

const DOCUMENT: &str = include_str!("../docs/scene-file.md");

/// The file of the document that has every key.
fn everything() -> &'static str {
    let start = DOCUMENT.find("```toml\n").unwrap() + "```toml\n".len();
    let rest = &DOCUMENT[start..];
    &rest[..rest.find("```").unwrap()]
}

fn parse(text: &str) -> Result<SceneFile, SceneFileError> {
    SceneFile::parse(text, Path::new("scenes/a.toml"))
}

const MODEL: &str = "[[model]]\nfile = \"ball.ply\"\n";

fn unit_box() -> Aabb {
    Aabb { min: [-1.0; 3], max: [1.0; 3] }
}

/// A panorama of two by one pixels, as a Radiance file.
const SKY: &[u8] = b"#?RADIANCE\n\n-Y 1 +X 2\n\x80\x40\x00\x81\x80\x80\x80\x80";

#[test]
fn every_documented_key_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, everything()).unwrap();
    std::fs::write(folder.path().join("sky.hdr"), SKY).unwrap();
    let file = SceneFile::read(&path).unwrap();
    let [ball, floor] = file.models.as_slice() else { panic!("{:?}", file.models) };
    assert_eq!(ball.file, folder.path().join("models/ball.ply"));
    let first = Affine::scale([2.0; 3])
        .then(&Affine::rotation([0.0, 1.0, 0.0], 30.0))
        .then(&Affine::rotation([1.0, 0.0, 0.0], 90.0))
        .then(&Affine::translation([1.0, 0.0, -1.0]));
    let second = Affine::from_rows([[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]]);
    let moved = Affine::scale([2.0; 3]).then(&Affine::translation([1.5, 0.0, -1.0]));
    assert_eq!(ball.places, [Place { map: first, end: Some(moved) }, Place::at_rest(second)]);
    assert_eq!(file.movements(), [(0, moved)]);
    assert_eq!((&floor.file, floor.places.len()), (&folder.path().join("floor.obj"), 0));
    let placed = |model, map| Instance { model, map };
    let instances = vec![placed(0, first), placed(0, second), placed(1, Affine::IDENTITY)];
    assert_eq!(file.instances(), Some(instances));
    assert_eq!(file.memory, Some(Bytes::mib(96)));
    assert_eq!(file.output, Some(folder.path().join("ball.exr")));
    let settings = RenderSettings {
        samples_per_pixel: 64,
        adaptive: Some(AdaptiveSampling { samples_min: 8, error: 0.01, confidence: 0.95 }),
        filter: Filter::Gaussian,
        seed: 7,
        contribution_bound: 0.0005,
        path_end: PathEnd::Roulette,
        work_budget: 4096,
        ..RenderSettings::new(320, 240)
    };
    assert_eq!(file.settings, settings);

    let budget = MemoryBudget::new(Bytes::mib(1));
    let scene = file.scene(&unit_box(), &budget).unwrap();
    let pinhole =
        |eye, look_at, up| Camera::new(eye, look_at, up, Projection::Pinhole { fov_degrees: 40.0 }).unwrap();
    let camera = pinhole([0.0, 1.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0])
        .with_lens(Lens { radius: 0.05, focus_distance: 5.0 })
        .unwrap()
        .moving_to(&pinhole([0.1, 1.0, 5.0], [0.0, 0.1, 0.0], [0.0, 1.0, 0.1]))
        .unwrap();
    assert_eq!(file.camera, Some(camera));
    let lights = [
        Light::Point {
            position: [1.0, 2.0, 3.0],
            intensity: [9.0, 8.0, 7.0],
            falloff: Falloff::InverseSquare { radius: 0.1 },
        },
        Light::directional([0.0, -1.0, 0.0], [0.5; 3]),
        Light::Spot {
            position: [0.0, 4.0, 0.0],
            direction: [0.0, -1.0, 0.0],
            intensity: [30.0; 3],
            falloff: Falloff::InverseSquare { radius: 0.2 },
            inner_degrees: 20.0,
            outer_degrees: 35.5,
        },
        Light::area(
            LightShape::Rectangle { corner: [-1.0, 3.0, -1.0], edges: [[2.0, 0.0, 0.0], [0.0, 0.0, 2.0]] },
            [4.0; 3],
        ),
        Light::area(LightShape::Disc { center: [3.0; 3], normal: [-1.0; 3], radius: 0.5 }, [5.0, 4.0, 3.0]),
        Light::area(LightShape::Sphere { center: [-3.0, 3.0, 3.0], radius: 0.25 }, [6.0; 3]),
    ];
    let image = EnvironmentImage::read(folder.path().join("sky.hdr"), &budget).unwrap();
    let expected = Scene::new(camera)
        .with_lights(lights)
        .with_background([0.1, 0.2, 0.3])
        .with_ambient([0.01, 0.01, 0.02])
        .with_interreflection()
        .with_environment(Environment::Image {
            image: image.into(),
            scale: 0.5,
            up: [0.0, 0.0, 1.0],
            front: [0.0, 1.0, 0.0],
        })
        .with_finish("blue glass", Finish { roughness: Some(0.3), priority: Some(2) });
    assert_eq!(scene, expected);
    assert_eq!(scene.lights(), lights);
    let glass = MaterialRecord { name: "blue glass".to_string(), ..MaterialRecord::default() };
    assert_eq!(scene.finish(&glass).priority, Some(2));
}

/// The keys of the file above that are read in place of others, and all that may be left out.
#[test]
fn what_is_left_out_is_chosen() {
    let budget = MemoryBudget::new(Bytes::mib(1));
    let file = parse(MODEL).unwrap();
    assert_eq!(file.models[0].file, Path::new("scenes/ball.ply"));
    assert_eq!(file.instances(), None);
    let each = parse(&format!("{MODEL}[[model.place]]\nscale = [1, 2, 3]\n")).unwrap();
    assert_eq!(each.models[0].places, [Place::at_rest(Affine::scale([1.0, 2.0, 3.0]))]);
    assert!(each.movements().is_empty());
    assert_eq!(
        (file.settings, file.memory, file.output.clone()),
        (RenderSettings::new(512, 512), None, None)
    );
    assert_eq!(file.scene(&unit_box(), &budget).unwrap(), Scene::automatic(&unit_box(), 1.0));

    let text = format!("{MODEL}[camera]\neye = [0, 0, 2]\nlook_at = [0, 0, 0]\n");
    let up = [0.0, 1.0, 0.0];
    let camera = Camera::pinhole([0.0, 0.0, 2.0], [0.0; 3], up, 45.0).unwrap();
    assert_eq!(parse(&text).unwrap().camera, Some(camera));
    let camera = Camera::orthographic([0.0, 0.0, 2.0], [0.0; 3], up, 1.5).unwrap();
    assert_eq!(parse(&(text + "orthographic_height = 1.5")).unwrap().camera, Some(camera));

    // Anything at all about light takes the place of what is chosen.
    let dark =
        parse(&format!("background = [0, 0, 0]\n{MODEL}")).unwrap().scene(&unit_box(), &budget).unwrap();
    assert_eq!(dark, Scene::new(Camera::framing(&unit_box(), 1.0)));
    let sky = parse(&format!("{MODEL}[environment]\nradiance = [1, 2, 3]\n")).unwrap();
    let expected = dark.clone().with_environment(Environment::Constant([1.0, 2.0, 3.0]));
    assert_eq!(sky.scene(&unit_box(), &budget).unwrap(), expected);
    assert_eq!(sky.environment_file(), None);
    let lamp =
        parse(&format!("{MODEL}[[light.point]]\nposition = [1, 2, 3]\nintensity = [1, 1, 1]\n")).unwrap();
    let expected = dark.with_light(Light::point([1.0, 2.0, 3.0], [1.0; 3]));
    assert_eq!(lamp.scene(&unit_box(), &budget).unwrap(), expected);
    for (name, filter) in [("box", Filter::Box), ("tent", Filter::Tent)] {
        let file = parse(&format!("{MODEL}[settings]\nfilter = \"{name}\"\npath_end = \"cut\"")).unwrap();
        assert_eq!((file.settings.filter, file.settings.path_end), (filter, PathEnd::Cut));
    }
}

/// The document's table and its file know the same keys, but for those that exclude each other.
#[test]
fn the_table_and_the_file_have_the_same_keys() {
    let mut documented = Vec::new();
    let mut table = String::new();
    for row in DOCUMENT.lines().filter(|line| line.starts_with("| ")) {
        let first = row.split('|').nth(1).unwrap().trim();
        if let Some(name) = first.strip_prefix("**`") {
            table = name.trim_end_matches("`**").replace("NAME", "\"blue glass\"");
        } else {
            documented
                .extend(first.split('`').skip(1).step_by(2).map(|key| (table.clone(), key.to_string())));
        }
    }
    let alone = [
        ("[[model.place]]", "matrix"),
        ("[model.place.shutter]", "matrix"),
        ("[model.place.shutter]", "rotate"),
        ("[camera]", "orthographic_height"),
        ("[environment]", "radiance"),
    ];
    documented.retain(|(table, key)| !alone.contains(&(table, key)));
    let mut written = Vec::new();
    table.clear();
    for line in everything().lines() {
        if line.starts_with('[') {
            table = line.to_string();
        } else if let Some((key, _)) = line.split_once(" =")
            && !(key == "matrix" || written.contains(&(table.clone(), key.to_string())))
        {
            written.push((table.clone(), key.to_string()));
        }
    }
    documented.sort();
    written.sort();
    assert_eq!(documented, written);
    assert!(written.len() > 40, "{}", written.len());
}

#[track_caller]
fn refused(text: &str) -> (u64, String, String) {
    match parse(text) {
        Err(SceneFileError::Key { path, line, key, reason }) => {
            assert_eq!(path, Path::new("scenes/a.toml"));
            (line, key, reason)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn misspelt_keys_are_errors_with_their_line() {
    let lines: Vec<&str> = everything().lines().collect();
    let mut tried = 0;
    for (index, line) in lines.iter().enumerate() {
        let Some((key, rest)) = line.split_once(" =") else { continue };
        let mut changed = lines.clone();
        let misspelt = format!("{key}x ={rest}");
        changed[index] = &misspelt;
        let (at, _, reason) = refused(&changed.join("\n"));
        assert!(reason.contains(&format!("{key}x")) || reason.contains(key), "{reason}");
        // A key that is needed may be missed first, at its table.
        assert!(at as usize <= index + 1 && index as u64 + 1 - at < 8, "{line}: line {at}");
        tried += 1;
    }
    assert!(tried > 40, "{tried}");
    // Tables, too.
    for table in ["[[light.disc]]", "[settings]", "[camera.lens]", "[environment]"] {
        let misspelt = everything().replace(table, &table.replace(']', "x]").replace("x]x]", "x]]"));
        let (line, _, reason) = refused(&misspelt);
        assert!(line > 1 && reason.contains("unknown field"), "{table}: {line}: {reason}");
    }
}

#[test]
fn senseless_values_are_errors_with_line_and_key() {
    let line_of = |text: &str, part: &str| 1 + text[..text.find(part).unwrap()].matches('\n').count() as u64;
    let cases = [
        ("file = \"floor.obj\"", "file = \"\"", "[[model]]\nfile = \"\"", "model[1]"),
        ("scale = 2", "scale = 0", "[[model.place]]", "model[0].place[0]"),
        ("scale = 2", "scale = [1, 2]", "scale", "model[0].place[0].scale"),
        ("axis = [1, 0, 0]", "axis = [0, 0, 0]", "[[model.place]]", "model[0].place[0]"),
        ("translate = [1", "translate = [inf", "[[model.place]]", "model[0].place[0]"),
        (
            "scale = 2",
            "matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]",
            "[[model.place]]",
            "model[0].place[0]",
        ),
        ("translate = [1.5", "translate = [nan", "[model.place.shutter]", "model[0].place[0].shutter"),
        (
            "translate = [1.5",
            "shutter = {}\ntranslate = [1.5",
            "[model.place.shutter]",
            "model[0].place[0].shutter",
        ),
        ("degrees = 90", "degree = 90", "rotate", "model[0].place[0].rotate[1].degree"),
        ("look_at = [0, 0, 0]", "look_at = [0, 1, 5]", "[camera]", "camera"),
        ("fov_degrees = 40", "fov_degrees = 180", "[camera]", "camera"),
        ("fov_degrees = 40", "fov_degrees = 40\northographic_height = 2", "[camera]", "camera"),
        ("radius = 0.05", "radius = -1", "[camera.lens]", "camera.lens"),
        ("look_at = [0, 0.1, 0]", "look_at = [0, 0, 9]", "[camera.shutter]", "camera.shutter"),
        ("intensity = [9, 8, 7]", "intensity = [9, 8, -7]", "[[light.point]]", "light.point[0]"),
        ("direction = [0, -1, 0]", "direction = [0, 0, 0]", "[[light.directional]]", "light.directional[0]"),
        ("outer_degrees = 35.5", "outer_degrees = 10", "[[light.spot]]", "light.spot[0]"),
        ("[0, 0, 2]]", "[4, 0, 0]]", "[[light.rectangle]]", "light.rectangle[0]"),
        ("radius = 0.5\n", "radius = 0\n", "[[light.disc]]", "light.disc[0]"),
        ("radius = 0.25", "radius = inf", "[[light.sphere]]", "light.sphere[0]"),
        ("scale = 0.5", "scale = nan", "[environment]", "environment"),
        ("scale = 0.5", "radiance = [1, 1, 1]", "[environment]", "environment"),
        ("front = [0, 1, 0]", "front = [0, 0, 2]", "[environment]", "environment"),
        ("roughness = 0.3", "roughness = 1.5", "[finish.", "finish.blue glass"),
        ("size = [320, 240]", "size = [320, 0]", "[settings]", "settings"),
        ("samples = 64", "samples = 65", "[settings]", "settings"),
        ("background = [0.1", "background = [-0.1", "background", "background"),
        ("memory = \"96MiB\"", "memory = \"much\"", "memory", "settings.memory"),
        ("ball.exr", "ball.gif", "output", "settings.output"),
        ("seed = 7", "seed = -7", "seed", "settings.seed"),
        ("filter = \"gaussian\"", "filter = \"sharp\"", "filter", "settings.filter"),
        ("eye = [0, 1, 5]", "eye = [0, 1]", "eye", "camera.eye"),
        ("error = 0.01", "error = \"small\"", "adaptive", "settings.adaptive.error"),
        ("corner = [-1, 3, -1]", "corner = [-1, 3, true]", "corner", "light.rectangle[0].corner[2]"),
    ];
    for (from, to, place, key) in cases {
        assert!(everything().contains(from), "{from}");
        let text = everything().replacen(from, to, 1);
        let (line, found, reason) = refused(&text);
        assert_eq!((line, found.as_str()), (line_of(&text, place), key), "{to}: {reason}");
        assert!(!reason.is_empty());
    }
    assert_eq!(refused("").1, "model");
    let (line, key, _) = refused("[[model]]\nfile = \"a.ply\"\n\n[camera\n");
    assert_eq!((line, key.as_str()), (4, ""));
    let message = parse("[[model]]\nfile = 3\n").unwrap_err().to_string();
    assert!(message.starts_with("scenes/a.toml:2: `model[0].file`: "), "{message}");
}

#[test]
fn files_that_are_no_text_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    assert!(matches!(SceneFile::read(&path), Err(SceneFileError::Io { .. })));
    std::fs::write(&path, b"# \xff\n").unwrap();
    assert!(matches!(SceneFile::read(&path), Err(SceneFileError::Text { .. })));
    std::fs::write(&path, vec![b'#'; 1 + SceneFile::BYTES_MAX as usize]).unwrap();
    assert!(matches!(SceneFile::read(&path), Err(SceneFileError::Text { .. })));
    // As deep as a file can be.
    assert_eq!(refused(&format!("model = {}", "[".repeat(1 << 20))).1, "");
}

#[test]
fn damaged_files_are_errors_or_other_scenes() {
    let whole = everything().as_bytes();
    let lines = everything().lines().count() as u64;
    let look = |bytes: &[u8]| {
        // What is no text is told before.
        let Ok(text) = std::str::from_utf8(bytes) else { return false };
        match parse(text) {
            Ok(_) => false,
            Err(SceneFileError::Key { line, .. }) => {
                assert!((1..=lines + 1).contains(&line), "{line}");
                true
            }
            Err(other) => panic!("{other}"),
        }
    };
    let (mut cut, mut flipped) = (0, 0);
    for at in 0..whole.len() {
        cut += u32::from(look(&whole[..at]));
        for bit in 0..8 {
            let mut bytes = whole.to_vec();
            bytes[at] ^= 1 << bit;
            flipped += u32::from(look(&bytes));
        }
    }
    // Most cuts end inside a table or a value.
    assert!(cut > 500 && flipped > 5000, "{cut} {flipped}");
}

#[test]
fn pictures_that_cannot_be_read_are_errors() {
    let budget = MemoryBudget::new(Bytes::mib(1));
    let file = parse(&format!("{MODEL}[environment]\nfile = \"none.hdr\"\n")).unwrap();
    assert!(file.environment_file().is_some_and(|path| path.ends_with("none.hdr")));
    let message = file.scene(&unit_box(), &budget).unwrap_err().to_string();
    assert!(message.contains("none.hdr"), "{message}");
    assert_eq!(budget.used(), Bytes(0));
}
