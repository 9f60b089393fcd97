//! From tables to the types of the rooms above, which say what makes sense.

use std::path::{Path, PathBuf};

use toml::Spanned;

use super::document::{
    CameraTable, Document, EnvironmentTable, FinishTable, LightTables, ModelTable, PlaceTable, RotateTable,
    Scale, SettingsTable,
};
use super::read::{Lighting, Place, Refused, SceneFile, SceneModel, Surroundings};
use crate::geom::Affine;
use crate::render::{AdaptiveSampling, ImageFormat, RenderSettings};
use crate::scene::{Camera, Environment, Falloff, Finish, Lens, Light, LightShape, Projection};
use crate::units::Bytes;

type Checked<T> = Result<T, Refused>;

/// Vertical angle of view, if the file does not say.
const FOV_DEGREES: f64 = 45.0;

/// Pixels of a side, if the file does not say.
const SIDE: u32 = 512;

/// Makes sense of a document; relative paths in it are relative to `folder`.
pub(super) fn check(document: &Document, folder: &Path) -> Checked<SceneFile> {
    if document.model.is_empty() {
        let reason = "there is none; add `[[model]]` with `file = \"...\"`".to_string();
        return Err(Refused { at: 0..0, key: "model".to_string(), reason });
    }
    let models = document.model.iter().enumerate();
    let models = models.map(|(index, table)| model(index, table, folder));
    let finishes = document.finish.iter().map(|(name, table)| finish(name, table));
    let (settings, memory, output) = match &document.settings {
        Some(table) => settings(table, folder)?,
        None => (RenderSettings::new(SIDE, SIDE), None, None),
    };
    Ok(SceneFile {
        models: models.collect::<Checked<_>>()?,
        settings,
        memory,
        output,
        camera: document.camera.as_ref().map(camera).transpose()?,
        lighting: lighting(document, folder)?,
        interreflection: document.interreflection,
        finishes: finishes.collect::<Checked<_>>()?,
    })
}

fn model(index: usize, table: &Spanned<ModelTable>, folder: &Path) -> Checked<SceneModel> {
    let key = format!("model[{index}]");
    if table.get_ref().file.as_os_str().is_empty() {
        return Err(Refused::new(table, key, "`file` is empty; name the model's file"));
    }
    let table = table.get_ref();
    let places = table.place.iter().enumerate();
    let places = places.map(|(number, table)| place(table, format!("{key}.place[{number}]")));
    Ok(SceneModel { file: folder.join(&table.file), places: places.collect::<Checked<_>>()? })
}

fn place(table: &Spanned<PlaceTable>, key: String) -> Checked<Place> {
    let map = map(table, key.clone())?;
    let end = table.get_ref().shutter.as_deref().map(|end| {
        let key = format!("{key}.shutter");
        if end.get_ref().shutter.is_some() {
            return Err(Refused::new(end, key, "has a shutter of its own; leave it out"));
        }
        self::map(end, key)
    });
    Ok(Place { map, end: end.transpose()? })
}

fn map(table: &Spanned<PlaceTable>, key: String) -> Checked<Affine> {
    let PlaceTable { scale, rotate, translate, matrix, shutter: _ } = table.get_ref();
    let map = match matrix {
        Some(rows) if scale.is_none() && rotate.is_empty() && translate.is_none() => Affine::from_rows(*rows),
        Some(_) => {
            let reason = "has a `matrix` beside `scale`, `rotate` or `translate`; leave one or the other out";
            return Err(Refused::new(table, key, reason));
        }
        None => {
            let factors = match scale {
                None => [1.0; 3],
                Some(Scale::All(factor)) => [*factor; 3],
                Some(Scale::Each(factors)) => *factors,
            };
            let mut map = Affine::scale(factors);
            for RotateTable { axis, degrees } in rotate {
                if axis.iter().all(|x| *x == 0.0) {
                    return Err(Refused::new(table, key, "the axis of a rotation is zero"));
                }
                map = map.then(&Affine::rotation(*axis, *degrees));
            }
            map.then(&Affine::translation(translate.unwrap_or([0.0; 3])))
        }
    };
    map.validate().map_err(|reason| Refused::new(table, key, reason))?;
    Ok(map)
}

fn finish(material: &str, table: &Spanned<FinishTable>) -> Checked<(String, Finish)> {
    let FinishTable { roughness, priority } = *table.get_ref();
    let finish = Finish { roughness, priority };
    finish.validate().map_err(Refused::because(table, format!("finish.{material}")))?;
    Ok((material.to_string(), finish))
}

fn camera(table: &Spanned<CameraTable>) -> Checked<Camera> {
    let CameraTable { eye, look_at, up, fov_degrees, orthographic_height, lens, shutter } = table.get_ref();
    let projection = match (fov_degrees, orthographic_height) {
        (Some(_), Some(_)) => {
            let reason = "has both `fov_degrees` and `orthographic_height`; leave one out";
            return Err(Refused::new(table, "camera", reason));
        }
        (None, Some(height)) => Projection::Orthographic { height: *height },
        (fov, None) => Projection::Pinhole { fov_degrees: fov.unwrap_or(FOV_DEGREES) },
    };
    let up = up.unwrap_or([0.0, 1.0, 0.0]);
    let mut camera =
        Camera::new(*eye, *look_at, up, projection).map_err(Refused::because(table, "camera"))?;
    if let Some(table) = lens {
        let lens = Lens { radius: table.get_ref().radius, focus_distance: table.get_ref().focus_distance };
        camera = camera.with_lens(lens).map_err(Refused::because(table, "camera.lens"))?;
    }
    if let Some(table) = shutter {
        let end = table.get_ref();
        let end = Camera::new(
            end.eye.unwrap_or(*eye),
            end.look_at.unwrap_or(*look_at),
            end.up.unwrap_or(up),
            projection,
        );
        let moving = end.and_then(|end| camera.moving_to(&end));
        camera = moving.map_err(Refused::because(table, "camera.shutter"))?;
    }
    Ok(camera)
}

/// `None` if the file says nothing at all about light.
fn lighting(document: &Document, folder: &Path) -> Checked<Option<Lighting>> {
    let mut colours = [[0.0; 3]; 2];
    let named = [("background", &document.background), ("ambient", &document.ambient)];
    for ((key, given), colour) in named.into_iter().zip(&mut colours) {
        let Some(given) = given else { continue };
        *colour = *given.get_ref();
        if colour.iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
            return Err(Refused::new(given, key, "each channel must be finite and not negative"));
        }
    }
    let [background, ambient] = colours;
    let lights = lights(&document.light)?;
    let environment = document.environment.as_ref().map(|table| surroundings(table, folder)).transpose()?;
    let says_nothing = lights.is_empty()
        && environment.is_none()
        && document.background.is_none()
        && document.ambient.is_none();
    Ok((!says_nothing).then_some(Lighting { lights, background, ambient, environment }))
}

/// Kind after kind, each in its order.
fn lights(tables: &LightTables) -> Checked<Vec<Light>> {
    let falloff = |radius: Option<f64>| match radius {
        Some(radius) => Falloff::InverseSquare { radius },
        None => Falloff::None,
    };
    let LightTables { point, directional, spot, rectangle, disc, sphere } = tables;
    let mut lights = Vec::new();
    gather(&mut lights, "point", point, |table| Light::Point {
        position: table.position,
        intensity: table.intensity,
        falloff: falloff(table.radius),
    })?;
    gather(&mut lights, "directional", directional, |table| {
        Light::directional(table.direction, table.intensity)
    })?;
    gather(&mut lights, "spot", spot, |table| Light::Spot {
        position: table.position,
        direction: table.direction,
        intensity: table.intensity,
        falloff: falloff(table.radius),
        inner_degrees: table.inner_degrees,
        outer_degrees: table.outer_degrees,
    })?;
    gather(&mut lights, "rectangle", rectangle, |table| {
        Light::area(LightShape::Rectangle { corner: table.corner, edges: table.edges }, table.radiance)
    })?;
    gather(&mut lights, "disc", disc, |table| {
        let shape = LightShape::Disc { center: table.center, normal: table.normal, radius: table.radius };
        Light::area(shape, table.radiance)
    })?;
    gather(&mut lights, "sphere", sphere, |table| {
        Light::area(LightShape::Sphere { center: table.center, radius: table.radius }, table.radiance)
    })?;
    Ok(lights)
}

/// Adds the lights of one kind.
fn gather<T>(
    lights: &mut Vec<Light>,
    kind: &str,
    tables: &[Spanned<T>],
    make: impl Fn(&T) -> Light,
) -> Checked<()> {
    for (index, table) in tables.iter().enumerate() {
        let light = make(table.get_ref());
        light.validate().map_err(Refused::because(table, format!("light.{kind}[{index}]")))?;
        lights.push(light);
    }
    Ok(())
}

fn surroundings(table: &Spanned<EnvironmentTable>, folder: &Path) -> Checked<Surroundings> {
    let key = "environment";
    let EnvironmentTable { radiance, file, scale, up, front } = table.get_ref();
    match (radiance, file) {
        (Some(radiance), None) => {
            if scale.is_some() || up.is_some() || front.is_some() {
                let reason =
                    "`scale`, `up` and `front` belong to a picture; leave them out beside `radiance`";
                return Err(Refused::new(table, key, reason));
            }
            Environment::Constant(*radiance).validate().map_err(Refused::because(table, key))?;
            Ok(Surroundings::Constant(*radiance))
        }
        (None, Some(file)) => {
            let (scale, up) = (scale.unwrap_or(1.0), up.unwrap_or([0.0, 1.0, 0.0]));
            let front = front.unwrap_or([0.0, 0.0, -1.0]);
            Environment::validate_picture(scale, up, front).map_err(Refused::because(table, key))?;
            Ok(Surroundings::Picture { file: folder.join(file), scale, up, front })
        }
        _ => Err(Refused::new(table, key, "needs either `radiance` or `file`")),
    }
}

/// Settings, memory and output.
fn settings(
    table: &Spanned<SettingsTable>,
    folder: &Path,
) -> Checked<(RenderSettings, Option<Bytes>, Option<PathBuf>)> {
    let given = table.get_ref();
    let [width, height] = given.size.unwrap_or([SIDE; 2]);
    let standard = RenderSettings::new(width, height);
    let settings = RenderSettings {
        samples_per_pixel: given.samples.unwrap_or(standard.samples_per_pixel),
        adaptive: given.adaptive.as_ref().map(|adaptive| AdaptiveSampling {
            samples_min: adaptive.samples_min,
            error: adaptive.error,
            confidence: adaptive.confidence,
        }),
        filter: given.filter.map_or(standard.filter, Into::into),
        seed: given.seed.unwrap_or(standard.seed),
        contribution_bound: given.contribution_bound.unwrap_or(standard.contribution_bound),
        path_end: given.path_end.map_or(standard.path_end, Into::into),
        work_budget: given.work_budget.unwrap_or(standard.work_budget),
        ..standard
    };
    settings.validate().map_err(Refused::because(table, "settings"))?;
    let memory = given.memory.as_ref().map(|text| {
        let refused =
            |error: crate::units::ParseBytesError| Refused::new(text, "settings.memory", error.to_string());
        text.get_ref().parse().map_err(refused)
    });
    let output = given.output.as_ref().map(|output| {
        let path = folder.join(output.get_ref());
        ImageFormat::of_path(&path).map_err(Refused::because(output, "settings.output"))?;
        Ok(path)
    });
    Ok((settings, memory.transpose()?, output.transpose()?))
}
