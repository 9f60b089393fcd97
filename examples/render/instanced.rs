//! Pictures of scenes of several models, or of models in several places.

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;

use outcrop::geom::Affine;
use outcrop::import::GltfPart;
use outcrop::instance::{GltfInstances, Instance, Instances};
use outcrop::model::Model;
use outcrop::octree::TreeQuality;
use outcrop::render::{Renderer, Threads};
use outcrop::scene::Scene;
use outcrop::texture::Textures;
use outcrop::{BlockSource, MemoryBudget};

use crate::Picture;
use crate::common::interrupt::Interrupt;
use crate::common::place::place_of;
use crate::common::progress::Meter;
use crate::compiled::{self, Compiled, Origin};
use crate::files;
use crate::options::Options;
use crate::summary::Summary;

/// What a scene of instances is made of.
pub struct Parts {
    /// A file for each model, and which part of it.
    models: Vec<(PathBuf, GltfPart)>,
    places: Vec<Instance>,
    /// Where instances are when the shutter closes, if they move.
    movements: Vec<(usize, Affine)>,
}

impl Parts {
    /// Those of a scene file or of a glTF file; none if the scene is one model as it is.
    pub fn of(options: &Options) -> Result<Option<Parts>, Box<dyn Error>> {
        if let Some(file) = &options.scene {
            return Ok(file.instances().map(|places| Parts {
                models: file.models.iter().map(|model| (model.file.clone(), GltfPart::Scene)).collect(),
                places,
                movements: file.movements(),
            }));
        }
        let Some(path) = options.shareable() else { return Ok(None) };
        Ok(GltfInstances::read(path)?.map(|found| Parts {
            models: found.parts.into_iter().map(|part| (path.to_path_buf(), part)).collect(),
            places: found.instances,
            movements: Vec::new(),
        }))
    }
}

/// A picture, and the models in it.
pub type Made = (Picture, Vec<Compiled>);

/// Compiles what is not compiled, and makes the picture; `None` if it was interrupted before.
pub fn picture(
    options: &Options,
    parts: Parts,
    budget: &MemoryBudget,
    interrupt: &Interrupt,
    meter: &mut Meter,
    summary: &mut Summary,
) -> Result<Option<Made>, Box<dyn Error>> {
    files::check_parts(options, &parts.models)?;
    let (mut compiled, mut sources) = (Vec::new(), Vec::<Arc<dyn BlockSource>>::new());
    let mut in_memory = Vec::new();
    for (number, (file, part)) in parts.models.iter().enumerate() {
        // A file that the scene names twice has one compiled file, which is made once.
        let is_it = |(other, of): &(PathBuf, GltfPart)| of == part && place_of(other) == place_of(file);
        if let Some(before) = parts.models[..number].iter().position(is_it) {
            sources.push(Arc::clone(&sources[before]));
            continue;
        }
        let options = Options { model: Some(file.clone()), part: part.clone(), ..options.clone() };
        let Some(model) = compiled::prepare(&options, budget, interrupt, meter)? else { return Ok(None) };
        meter.finish();
        summary.compiled(&model);
        in_memory.push(crate::reserve_source(&options, &model.origin, budget)?);
        sources.push(match &model.origin {
            Origin::File(path) => crate::open(&options, path, budget)?,
            Origin::Lazy(model) => Arc::clone(model) as Arc<dyn BlockSource>,
        });
        compiled.push(model);
    }
    let models: Vec<Arc<Model>> = sources.iter().map(|source| Arc::clone(source.model())).collect();
    let models: Vec<&Model> = models.iter().map(|model| &**model).collect();
    let bounds = Instances::bounds_of(&models, &parts.places)?;
    let scene = with_textures(crate::scene(options, &bounds, budget)?, options, &parts, &models, budget)?;
    let threads = Threads::Count(options.threads as usize);
    // The caches take what is left of the budget, so the picture's share is set aside first.
    let picture_bytes = Renderer::bytes_needed_for(&models, &scene, &options.settings, &threads)?;
    let set_aside = budget.reserve(picture_bytes, "the picture")?;
    let for_layers = crate::reserve_layers(options, budget)?;
    let octree_options = crate::octree_options(options, TreeQuality::Best);
    let mut instances = Instances::open(&sources, parts.places, budget, &octree_options)?;
    drop(set_aside);
    instances.move_while_open(&parts.movements)?;
    summary.placed(&instances, picture_bytes);
    let renderer = Renderer::over_instances(&instances, &scene, &options.settings, budget)?;
    let picture = crate::draw(&renderer, options, for_layers, interrupt, meter)?;
    Ok(Some((picture, compiled)))
}

/// The scene with the pictures that the models' materials name. They are named from one folder.
fn with_textures(
    scene: Scene,
    options: &Options,
    parts: &Parts,
    models: &[&Model],
    budget: &MemoryBudget,
) -> Result<Scene, Box<dyn Error>> {
    let has_images = |model: &&Model| !Textures::named_by(&model.materials).is_empty();
    let mut with_images = parts.models.iter().zip(models).filter(|(_, model)| has_images(model));
    let Some(((first, _), _)) = with_images.next() else { return Ok(scene) };
    if let Some(((other, _), _)) = with_images.find(|((other, _), _)| other.parent() != first.parent()) {
        return Err(format!(
            "{} and {}: models with images must lie in one folder; move one with its images",
            first.display(),
            other.display()
        )
        .into());
    }
    let materials: Vec<_> = models.iter().flat_map(|model| model.materials.iter().cloned()).collect();
    crate::with_textures(scene, &materials, first, options, budget)
}
