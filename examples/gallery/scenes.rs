//! The scenes: one for each effect, and some that bring several together.

use std::error::Error;
use std::sync::Arc;

use outcrop::MemoryBudget;
use outcrop::model::MaterialRecord;
use outcrop::scene::{
    Camera, Effect, Environment, EnvironmentImage, Falloff, Finish, Lens, Light, LightShape, Scene,
};
use outcrop::units::Bytes;
use tempfile::TempDir;

use crate::mesh::Mesh;
use crate::{city, surfaces};

/// One picture of the gallery.
pub struct Entry {
    pub name: &'static str,
    pub title: &'static str,
    /// The effects that it is about, if it is about any.
    pub effects: &'static [Effect],
    pub mesh: Mesh,
    pub scene: Scene,
    pub samples_per_pixel: u32,
    /// What there is to say beside the plan.
    pub note: &'static str,
    /// What it may not call for; the example fails if it does.
    pub excluded: &'static [Effect],
    /// What attributes and textures may take, where that is less than all of them.
    pub detail_bytes: Option<Bytes>,
    /// Where its images are, until it has been rendered.
    #[expect(dead_code, reason = "held, not read")]
    pub folder: Option<TempDir>,
}

impl Entry {
    pub fn new(
        [name, title]: [&'static str; 2],
        effects: &'static [Effect],
        mesh: Mesh,
        scene: Scene,
        samples_per_pixel: u32,
    ) -> Entry {
        let (note, excluded, detail_bytes, folder) = ("", &[][..], None, None);
        Entry { name, title, effects, mesh, scene, samples_per_pixel, note, excluded, detail_bytes, folder }
    }
}

pub fn matt(diffuse: [f32; 3]) -> MaterialRecord {
    MaterialRecord { diffuse, ..MaterialRecord::default() }
}

pub fn shiny(diffuse: [f32; 3]) -> MaterialRecord {
    MaterialRecord { specular: [0.35; 3], shininess: 60.0, ..matt(diffuse) }
}

pub fn metal(specular: [f32; 3]) -> MaterialRecord {
    MaterialRecord { diffuse: [0.0; 3], specular, mirror: true, ..MaterialRecord::default() }
}

/// Clear glass; `tint` is what is left of light after a unit of length.
pub fn glass(refractive_index: f32, tint: [f32; 3]) -> MaterialRecord {
    MaterialRecord {
        diffuse: [0.0; 3],
        opacity: 0.0,
        refractive_index,
        transmission: tint,
        ..MaterialRecord::default()
    }
}

const CLEAR: [f32; 3] = [1.0; 3];
const UP: [f64; 3] = [0.0, 1.0, 0.0];

pub fn camera(eye: [f64; 3], look_at: [f64; 3], fov: f64) -> Result<Camera, Box<dyn Error>> {
    Ok(Camera::pinhole(eye, look_at, UP, fov)?)
}

/// A ground in pale and dark squares.
pub fn ground(mesh: &mut Mesh) {
    let pale = mesh.material("pale tile", matt([0.62, 0.6, 0.56]));
    let dark = mesh.material("dark tile", matt([0.3, 0.31, 0.33]));
    mesh.checkers([pale, dark], 0.0, 0.5, 24);
}

/// A rectangle above the scene that shines downward.
pub fn panel(center: [f64; 3], width: f64, depth: f64, radiance: [f32; 3]) -> Light {
    let corner = [center[0] - 0.5 * width, center[1], center[2] - 0.5 * depth];
    let edges = [[width, 0.0, 0.0], [0.0, 0.0, depth]];
    Light::area(LightShape::Rectangle { corner, edges }, radiance)
}

/// A sky with haze and a low sun, computed.
pub fn sky(budget: &MemoryBudget) -> Result<Environment, Box<dyn Error>> {
    const WIDTH: u32 = 256;
    const HEIGHT: u32 = 128;
    let sun = [0.55f64, 0.5, 0.67];
    let pixels = (0..WIDTH * HEIGHT).map(|index| {
        let (x, y) = (index % WIDTH, index / WIDTH);
        let height = std::f64::consts::PI * (f64::from(y) + 0.5) / f64::from(HEIGHT);
        let angle = std::f64::consts::TAU * ((f64::from(x) + 0.5) / f64::from(WIDTH) - 0.5);
        let direction = [height.sin() * angle.sin(), height.cos(), height.sin() * angle.cos()];
        let toward = (0..3).map(|axis| direction[axis] * sun[axis]).sum::<f64>();
        let up = direction[1].max(0.0);
        let haze = (1.0 - up).powi(4);
        let glow = toward.max(0.0).powi(24);
        let disc = if toward > 0.9985 { 220.0 } else { 0.0 };
        let below = if direction[1] < 0.0 { 0.35 } else { 1.0 };
        [
            (0.16 + 0.62 * haze + 0.9 * glow + disc) * below,
            (0.32 + 0.46 * haze + 0.6 * glow + 0.9 * disc) * below,
            (0.72 + 0.18 * haze + 0.25 * glow + 0.75 * disc) * below,
        ]
        .map(|channel| channel as f32)
    });
    let image = EnvironmentImage::new(WIDTH, HEIGHT, pixels.collect(), budget)?;
    Ok(Environment::image(Arc::new(image)))
}

/// Every picture, in the order of the page.
pub fn all(budget: &MemoryBudget, quick: bool) -> Result<Vec<Entry>, Box<dyn Error>> {
    Ok(vec![
        bricks()?,
        spot()?,
        area_light()?,
        environment_light(budget)?,
        mirrors()?,
        glossy(budget)?,
        glass_stack()?,
        frosted(budget)?,
        absorption(budget)?,
        nested(budget)?,
        interreflection()?,
        depth_of_field()?,
        motion_blur()?,
        surfaces::smooth_normals()?,
        surfaces::textures(budget)?,
        surfaces::cut_outs()?,
        surfaces::bumps()?,
        surfaces::finishes(budget)?,
        emission()?,
        cornell_box()?,
        interior()?,
        city::city(budget, if quick { 128 } else { 1024 })?,
    ])
}

pub fn bricks() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let tones = [[0.62, 0.28, 0.2], [0.55, 0.24, 0.18], [0.68, 0.34, 0.24]];
    let bricks = tones.map(|tone| mesh.material("brick", matt(tone)));
    for row in 0..7 {
        for place in 0..9 {
            let shift = if row % 2 == 0 { 0.0 } else { 0.21 };
            let foot = [-1.7 + 0.42 * f64::from(place) + shift, 0.2 * f64::from(row), 0.0];
            mesh.block(bricks[(place * 2 + row * 5) as usize % 3], foot, [0.4, 0.185, 0.2], 0.0);
        }
    }
    let scene = Scene::new(camera([1.6, 1.7, 4.2], [0.05, 0.55, 0.0], 36.0)?)
        .with_background([0.55, 0.66, 0.78])
        .with_ambient([0.22, 0.24, 0.28])
        .with_light(Light::directional([0.7, -1.0, -0.75], [0.9, 0.84, 0.72]));
    let (name, title) = ("bricks", "Matt bricks: direct light and shadows, nothing else");
    Ok(Entry::new([name, title], &[Effect::Shadows, Effect::Antialiasing], mesh, scene, 9))
}

fn spot() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let body = mesh.material("plaster", shiny([0.75, 0.72, 0.66]));
    mesh.ball(body, [-0.55, 0.5, 0.0], 0.5);
    mesh.block(body, [0.65, 0.0, -0.2], [0.6, 1.1, 0.6], 25.0);
    let lamp = |position: [f64; 3], intensity, outer_degrees| Light::Spot {
        position,
        direction: [0, 1, 2].map(|axis| [0.0, 0.3, 0.0][axis] - position[axis]),
        intensity,
        falloff: Falloff::InverseSquare { radius: 0.1 },
        inner_degrees: 0.6 * outer_degrees,
        outer_degrees,
    };
    let scene = Scene::new(camera([0.4, 2.2, 4.6], [0.0, 0.35, 0.0], 36.0)?)
        .with_ambient([0.02, 0.022, 0.03])
        .with_light(lamp([2.2, 3.0, 2.0], [15.0, 12.0, 8.0], 17.0))
        .with_light(lamp([-2.6, 2.6, 1.2], [5.0, 7.5, 13.0], 19.0));
    let (name, title) = ("spot-light", "Two spot lights that fall off with distance");
    Ok(Entry::new([name, title], &[Effect::DirectLight], mesh, scene, 9))
}

fn area_light() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let body = mesh.material("clay", matt([0.7, 0.5, 0.38]));
    mesh.block(body, [-0.7, 0.0, 0.0], [0.5, 1.3, 0.5], 20.0);
    mesh.ball(body, [0.45, 0.45, 0.15], 0.45);
    let bulb = LightShape::Sphere { center: [1.25, 0.3, -0.35], radius: 0.16 };
    let scene = Scene::new(camera([0.5, 2.0, 4.4], [0.0, 0.45, 0.0], 36.0)?)
        .with_ambient([0.03, 0.035, 0.045])
        .with_light(panel([-1.4, 2.6, 1.2], 1.4, 1.4, [11.0, 10.6, 10.0]))
        .with_light(Light::area(bulb, [14.0, 8.5, 3.4]));
    let (name, title) = ("area-light", "A rectangle above and a glowing ball: soft shadows");
    Ok(Entry::new([name, title], &[Effect::AreaLight], mesh, scene, 25))
}

fn environment_light(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let plaster = mesh.material("plaster", matt([0.8, 0.79, 0.76]));
    let chrome = mesh.material("chrome", metal([0.85, 0.86, 0.88]));
    mesh.ball(plaster, [-0.6, 0.5, 0.0], 0.5);
    mesh.ball(chrome, [0.55, 0.5, 0.1], 0.5);
    let scene = Scene::new(camera([0.0, 1.3, 4.6], [0.0, 0.55, 0.0], 36.0)?).with_environment(sky(budget)?);
    let (name, title) = ("environment-light", "A sky with a small sun, sampled by importance");
    Ok(Entry::new([name, title], &[Effect::EnvironmentLight], mesh, scene, 25))
}

fn mirrors() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let silver = mesh.material("silver", metal([0.9, 0.9, 0.88]));
    let frame = mesh.material("frame", shiny([0.35, 0.2, 0.1]));
    let red = mesh.material("red", shiny([0.7, 0.12, 0.1]));
    let blue = mesh.material("blue", shiny([0.1, 0.22, 0.6]));
    for (x, degrees) in [(-1.1, 35.0), (1.1, -35.0)] {
        mesh.block(frame, [x, 0.0, -0.75], [1.7, 1.7, 0.08], degrees);
        let turn = f64::to_radians(degrees);
        mesh.block(
            silver,
            [x + 0.05 * turn.sin(), 0.1, -0.75 + 0.05 * turn.cos()],
            [1.5, 1.5, 0.08],
            degrees,
        );
    }
    mesh.ball(red, [0.0, 0.35, 0.35], 0.35);
    mesh.block(blue, [0.62, 0.0, 0.55], [0.3, 0.6, 0.3], 10.0);
    let scene = Scene::new(camera([0.1, 1.6, 4.6], [0.0, 0.6, 0.0], 38.0)?)
        .with_background([0.6, 0.68, 0.75])
        .with_ambient([0.2, 0.2, 0.22])
        .with_light(Light::directional([-0.4, -1.0, -0.8], [0.75, 0.72, 0.66]));
    let (name, title) = ("mirrors", "Two mirrors that see each other");
    Ok(Entry::new([name, title], &[Effect::Reflection], mesh, scene, 9))
}

fn glossy(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let mut scene = Scene::new(camera([0.0, 1.5, 5.2], [0.0, 0.42, 0.0], 34.0)?)
        .with_environment(sky(budget)?)
        .with_light(panel([0.0, 2.4, 1.0], 1.6, 0.4, [5.0, 4.6, 4.0]));
    for (place, roughness) in [0.12f32, 0.28, 0.45, 0.7].into_iter().enumerate() {
        let name = format!("copper {roughness}");
        let copper = mesh.material(&name, metal([0.92, 0.58, 0.42]));
        scene = scene.with_finish(name, Finish::rough(roughness));
        mesh.ball(copper, [-1.35 + 0.9 * place as f64, 0.42, 0.0], 0.42);
    }
    let (name, title) = ("glossy-reflection", "Copper of roughness 0.12, 0.28, 0.45 and 0.7");
    Ok(Entry::new([name, title], &[Effect::GlossyReflection], mesh, scene, 25))
}

fn glass_stack() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let pane = mesh.material("pane", glass(1.5, [0.75, 0.93, 0.86]));
    let red = mesh.material("red", matt([0.75, 0.15, 0.1]));
    for place in 0..7 {
        mesh.block(
            pane,
            [-0.35 + 0.08 * f64::from(place), 0.002, 0.9 - 0.22 * f64::from(place)],
            [1.1, 1.1, 0.06],
            0.0,
        );
    }
    mesh.ball(red, [0.05, 0.45, -1.1], 0.45);
    let scene = Scene::new(camera([1.5, 1.4, 4.0], [-0.05, 0.5, 0.0], 34.0)?)
        .with_background([0.6, 0.7, 0.8])
        .with_ambient([0.25; 3])
        .with_light(Light::directional([-0.5, -1.0, -0.5], [0.7, 0.68, 0.62]));
    let (name, title) =
        ("glass-stack", "Seven panes of glass: refraction, Fresnel and all reflections between them");
    Ok(Entry::new([name, title], &[Effect::Transmission], mesh, scene, 4))
}

fn frosted(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let mut scene =
        Scene::new(camera([0.0, 1.5, 5.2], [0.0, 0.42, 0.0], 34.0)?).with_environment(sky(budget)?);
    for (place, roughness) in [0.0f32, 0.2, 0.35, 0.55].into_iter().enumerate() {
        let name = format!("glass {roughness}");
        let material = mesh.material(&name, glass(1.5, CLEAR));
        scene = scene.with_finish(name, Finish::rough(roughness));
        mesh.ball(material, [-1.35 + 0.9 * place as f64, 0.42, 0.0], 0.42);
    }
    for (place, tone) in
        [[0.8, 0.2, 0.15], [0.85, 0.65, 0.1], [0.15, 0.5, 0.25], [0.15, 0.3, 0.7]].into_iter().enumerate()
    {
        let post = mesh.material("post", matt(tone));
        mesh.block(post, [-1.8 + 1.2 * place as f64, 0.0, -1.3], [0.35, 1.3, 0.35], 15.0);
    }
    let (name, title) = ("rough-refraction", "Glass of roughness 0, 0.2, 0.35 and 0.55");
    Ok(Entry::new([name, title], &[Effect::RoughRefraction], mesh, scene, 25))
}

fn absorption(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let green = mesh.material("bottle glass", glass(1.5, [0.12, 0.72, 0.3]));
    let amber = mesh.material("amber", glass(1.54, [0.85, 0.42, 0.04]));
    for (place, width) in [0.15f64, 0.35, 0.7].into_iter().enumerate() {
        mesh.block(green, [-1.1 + 0.75 * place as f64, 0.002, -0.1], [width, 0.9, width], 30.0);
    }
    mesh.ball(amber, [1.25, 0.4, 0.2], 0.4);
    let scene = Scene::new(camera([0.4, 1.9, 4.6], [0.05, 0.38, 0.0], 36.0)?).with_environment(sky(budget)?);
    let (name, title) = ("absorption", "The same green glass, thin and thick, and amber");
    Ok(Entry::new([name, title], &[Effect::Absorption], mesh, scene, 16))
}

fn nested(budget: &MemoryBudget) -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let tumbler = mesh.material("tumbler", glass(1.5, [0.93, 0.97, 0.95]));
    let water = mesh.material("water", glass(1.33, [0.72, 0.88, 0.95]));
    let straw = mesh.material("straw", shiny([0.85, 0.2, 0.15]));
    let ice = mesh.material("ice", glass(1.31, CLEAR));
    let (radius, wall, height, level) = (0.55, 0.07, 1.25, 0.95);
    let inner = radius - wall;
    let profile =
        [[0.0, 0.002], [radius, 0.002], [radius, height], [inner, height], [inner, 0.12], [0.0, 0.12]];
    mesh.lathe(tumbler, [0.0; 3], &profile, 160);
    // Its surface coincides with that of the glass.
    mesh.lathe(water, [0.0; 3], &[[0.0, 0.12], [inner, 0.12], [inner, level], [0.0, level]], 160);
    mesh.block(ice, [-0.14, 0.74, 0.1], [0.3, 0.3, 0.3], 25.0);
    mesh.block(straw, [0.16, 0.125, -0.1], [0.06, 1.55, 0.06], 40.0);
    let scene = Scene::new(camera([0.3, 1.5, 4.1], [0.0, 0.62, 0.0], 30.0)?)
        .with_environment(sky(budget)?)
        .with_finish("tumbler", Finish::nested(3))
        .with_finish("ice", Finish::nested(2))
        .with_finish("water", Finish::nested(1));
    let (name, title) = (
        "nested-media",
        "Water whose surface coincides with that of its glass, and ice that overlaps both water and air",
    );
    Ok(Entry::new([name, title], &[Effect::NestedMedia], mesh, scene, 9))
}

fn interreflection() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    let white = mesh.material("white", matt([0.82; 3]));
    let red = mesh.material("red", matt([0.8, 0.08, 0.05]));
    let green = mesh.material("green", matt([0.1, 0.6, 0.12]));
    mesh.quad(white, [-3.0, 0.0, -2.0], [0.0, 0.0, 6.0], [6.0, 0.0, 0.0]);
    mesh.quad(white, [-3.0, 0.0, -1.2], [6.0, 0.0, 0.0], [0.0, 3.0, 0.0]);
    mesh.block(red, [-0.95, 0.0, -0.2], [0.12, 1.2, 1.5], 12.0);
    mesh.block(green, [0.95, 0.0, -0.2], [0.12, 1.2, 1.5], -12.0);
    mesh.ball(white, [0.0, 0.4, 0.0], 0.4);
    let scene = Scene::new(camera([0.0, 1.5, 4.6], [0.0, 0.5, 0.0], 32.0)?)
        .with_interreflection()
        .with_light(panel([0.0, 2.8, 0.6], 1.2, 1.2, [7.0, 6.8, 6.4]));
    let (name, title) = ("interreflection", "Colour that one wall casts on another");
    Ok(Entry::new([name, title], &[Effect::Interreflection], mesh, scene, 64))
}

/// Posts and balls in a row away from the viewer.
fn avenue(mesh: &mut Mesh) {
    ground(mesh);
    let tones = [[0.75, 0.2, 0.15], [0.85, 0.6, 0.15], [0.2, 0.55, 0.3], [0.15, 0.35, 0.7], [0.5, 0.25, 0.6]];
    for (place, tone) in tones.into_iter().enumerate() {
        let material = mesh.material("paint", shiny(tone));
        let z = 1.6 - 1.1 * place as f64;
        mesh.ball(material, [-0.9 + 0.42 * place as f64, 0.3, z], 0.3);
        mesh.block(material, [0.25 + 0.5 * place as f64, 0.0, z - 0.2], [0.18, 0.9, 0.18], 20.0);
    }
}

pub fn daylight(camera: Camera) -> Scene {
    Scene::new(camera)
        .with_background([0.6, 0.7, 0.82])
        .with_ambient([0.25, 0.26, 0.3])
        .with_light(Light::directional([0.5, -1.0, -0.6], [0.8, 0.76, 0.68]))
}

fn depth_of_field() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    avenue(&mut mesh);
    let view = camera([-0.2, 1.0, 4.2], [0.05, 0.3, 0.0], 34.0)?;
    let lens = Lens { radius: 0.12, focus_distance: 3.7 };
    let scene = daylight(view.with_lens(lens)?);
    let (name, title) = ("depth-of-field", "A lens in focus at the second row");
    Ok(Entry::new([name, title], &[Effect::DepthOfField], mesh, scene, 36))
}

fn motion_blur() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    avenue(&mut mesh);
    let start = camera([-0.32, 1.0, 4.2], [0.05, 0.3, 0.0], 34.0)?;
    let end = camera([-0.02, 1.0, 4.2], [0.05, 0.3, 0.0], 34.0)?;
    let scene = daylight(start.moving_to(&end)?);
    let (name, title) = ("motion-blur", "The camera passes by and keeps its eye on the middle");
    Ok(Entry::new([name, title], &[Effect::MotionBlur], mesh, scene, 36))
}

/// Lanterns that are nothing but triangles that glow.
fn emission() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    ground(&mut mesh);
    let plaster = mesh.material("plaster", matt([0.75, 0.73, 0.7]));
    let frame = mesh.material("frame", matt([0.06, 0.05, 0.05]));
    mesh.quad(plaster, [-4.0, 0.0, -1.3], [8.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    let tones = [[1.7, 0.45, 0.12], [1.35, 1.0, 0.5], [0.16, 0.5, 1.6]];
    for (place, emission) in tones.into_iter().enumerate() {
        let paper = mesh.material("paper", MaterialRecord { emission, ..matt([0.5; 3]) });
        let (x, z) = (1.25 * (place as f64 - 1.0), if place == 1 { -0.35 } else { 0.1 });
        let (turn, height) = (20.0 + 25.0 * place as f64, if place == 1 { 1.15 } else { 0.75 });
        mesh.block(paper, [x, 0.06, z], [0.56, height, 0.56], turn);
        for y in [0.0, 0.06 + height] {
            mesh.block(frame, [x, y, z], [0.64, 0.06, 0.64], turn);
        }
    }
    mesh.ball(plaster, [-0.5, 0.22, 0.8], 0.22);
    mesh.ball(plaster, [0.62, 0.3, 0.75], 0.3);
    let scene = Scene::new(camera([0.0, 1.45, 4.9], [0.0, 0.6, 0.0], 33.0)?).with_interreflection();
    let (name, title) = ("emission", "Lanterns of triangles that glow, and what they light");
    Ok(Entry::new([name, title], &[Effect::Emission], mesh, scene, 196))
}

/// The Cornell box in its usual proportions, one unit wide.
fn cornell_box() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    let white = mesh.material("white", matt([0.73; 3]));
    let red = mesh.material("red", matt([0.63, 0.065, 0.05]));
    let green = mesh.material("green", matt([0.14, 0.45, 0.091]));
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    mesh.quad(white, [0.0; 3], z, x);
    mesh.quad(white, y, x, z);
    mesh.quad(white, [0.0; 3], x, y);
    mesh.quad(red, [0.0; 3], y, z);
    mesh.quad(green, x, z, y);
    mesh.block(white, [0.335, 0.0, 0.37], [0.3, 0.6, 0.3], 17.0);
    mesh.block(white, [0.665, 0.0, 0.7], [0.3, 0.3, 0.3], -18.0);
    let scene = Scene::new(camera([0.5, 0.5, 2.4], [0.5, 0.5, 0.0], 39.0)?)
        .with_interreflection()
        .with_light(panel([0.5, 0.9999, 0.5], 0.24, 0.19, [17.0, 12.0, 4.0]));
    let (name, title) = ("cornell-box", "The Cornell box");
    Ok(Entry::new([name, title], &[], mesh, scene, 64))
}

/// A room with a window and a lamp.
fn interior() -> Result<Entry, Box<dyn Error>> {
    let mut mesh = Mesh::new();
    let wall = mesh.material("wall", matt([0.8, 0.78, 0.72]));
    let wood = mesh.material("parquet", matt([0.5, 0.33, 0.2]));
    let dark = mesh.material("dark parquet", matt([0.42, 0.27, 0.16]));
    let cloth = mesh.material("cloth", matt([0.25, 0.36, 0.5]));
    let table = mesh.material("table", shiny([0.3, 0.17, 0.09]));
    let vase = mesh.material("vase", shiny([0.75, 0.32, 0.2]));
    let (w, h, d) = (4.0, 2.5, 5.0);
    // Floor in boards, ceiling, back and right wall; the left one is around a window.
    for board in 0..20 {
        let material = if board % 2 == 0 { wood } else { dark };
        mesh.quad(material, [0.2 * f64::from(board), 0.0, 0.0], [0.0, 0.0, d], [0.2, 0.0, 0.0]);
    }
    mesh.quad(wall, [0.0, h, 0.0], [w, 0.0, 0.0], [0.0, 0.0, d]);
    mesh.quad(wall, [0.0, 0.0, 0.0], [w, 0.0, 0.0], [0.0, h, 0.0]);
    mesh.quad(wall, [w, 0.0, 0.0], [0.0, 0.0, d], [0.0, h, 0.0]);
    mesh.quad(wall, [0.0, 0.0, d], [0.0, h, 0.0], [w, 0.0, 0.0]);
    for (foot, size) in [
        ([-0.1, 0.0, 2.5], [0.2, 0.8, 5.0]),
        ([-0.1, 2.2, 2.5], [0.2, 0.3, 5.0]),
        ([-0.1, 0.8, 0.35], [0.2, 1.4, 0.7]),
        ([-0.1, 0.8, 2.0], [0.2, 1.4, 0.12]),
        ([-0.1, 0.8, 4.15], [0.2, 1.4, 1.7]),
    ] {
        mesh.block(wall, foot, size, 0.0);
    }
    // A sofa, a table with a vase.
    mesh.block(cloth, [2.9, 0.0, 0.6], [1.8, 0.42, 0.8], 0.0);
    mesh.block(cloth, [2.9, 0.42, 0.3], [1.8, 0.45, 0.2], 0.0);
    mesh.block(cloth, [2.1, 0.42, 0.65], [0.2, 0.2, 0.7], 0.0);
    mesh.block(cloth, [3.7, 0.42, 0.65], [0.2, 0.2, 0.7], 0.0);
    mesh.block(table, [1.6, 0.4, 1.9], [1.0, 0.06, 0.7], 12.0);
    for (x, z) in [(1.2, 1.75), (1.95, 1.6), (1.25, 2.25), (2.0, 2.1)] {
        mesh.block(table, [x, 0.0, z], [0.06, 0.4, 0.06], 12.0);
    }
    let profile = [[0.0, 0.0], [0.09, 0.0], [0.14, 0.12], [0.1, 0.28], [0.06, 0.34], [0.0, 0.34]];
    mesh.lathe(vase, [1.55, 0.461, 1.9], &profile, 96);
    let bulb = LightShape::Sphere { center: [3.5, 1.75, 0.5], radius: 0.14 };
    // The sky that the window shows is light with extent in its two openings; the sun comes through them.
    let pane = |z: f64| {
        let edges = [[0.0, 1.4, 0.0], [0.0, 0.0, 1.24]];
        Light::area(LightShape::Rectangle { corner: [0.0, 0.8, z], edges }, [2.0, 2.4, 3.0])
    };
    let scene = Scene::new(camera([2.5, 1.35, 4.8], [1.75, 0.95, 0.0], 56.0)?)
        .with_background([0.75, 0.88, 1.0])
        .with_interreflection()
        .with_light(Light::directional([1.0, -0.75, -0.3], [2.4, 2.0, 1.5]))
        .with_light(pane(0.7))
        .with_light(pane(2.06))
        .with_light(Light::area(bulb, [9.0, 6.2, 3.4]));
    let (name, title) = ("interior", "A room lit by its window, the sun and one lamp");
    let note = "Free of caustics: no surface refracts or mirrors, so between lamp, sky and wall light is scattered by matt surfaces only, and nothing gathers it to \
                a bright spot that few paths find. The window is a hole without a pane, vase and table are glazed and varnished by highlights alone. The example \
                fails if the plan holds reflection or transmission.";
    let excluded = &[Effect::Reflection, Effect::Transmission];
    Ok(Entry { note, excluded, ..Entry::new([name, title], &[], mesh, scene, 64) })
}
