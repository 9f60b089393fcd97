//! Pictures of scenes of several models, or of models in several places.

use std::error::Error;
use std::sync::Arc;

use outcrop::instance::{Instance, Instances};
use outcrop::model::Model;
use outcrop::octree::TreeQuality;
use outcrop::render::{RenderedImage, Renderer, Threads};
use outcrop::scene::Scene;
use outcrop::scene_file::SceneFile;
use outcrop::texture::Textures;
use outcrop::{BlockSource, MemoryBudget};

use crate::common::interrupt::Interrupt;
use crate::common::progress::Meter;
use crate::compiled::{self, Compiled, Origin};
use crate::options::Options;
use crate::summary::Summary;

/// Compiles what is not compiled, and makes the picture.
pub fn picture(
    options: &Options,
    file: &SceneFile,
    places: Vec<Instance>,
    budget: &MemoryBudget,
    interrupt: &Interrupt,
    meter: &mut Meter,
    summary: &mut Summary,
) -> Result<(RenderedImage, Vec<Compiled>), Box<dyn Error>> {
    let (mut compiled, mut sources) = (Vec::new(), Vec::new());
    for model in &file.models {
        let options = Options { model: Some(model.file.clone()), ..options.clone() };
        let model = compiled::prepare(&options, budget, interrupt, meter)?;
        meter.finish();
        summary.compiled(&model);
        sources.push(match &model.origin {
            Origin::File(path) => crate::open(&options, path)?,
            Origin::Lazy(model) => Arc::clone(model) as Arc<dyn BlockSource>,
        });
        compiled.push(model);
    }
    let models: Vec<Arc<Model>> = sources.iter().map(|source| Arc::clone(source.model())).collect();
    let models: Vec<&Model> = models.iter().map(|model| &**model).collect();
    let bounds = Instances::bounds_of(&models, &places)?;
    let mut in_shape = file.clone();
    in_shape.settings = options.settings;
    let scene = with_textures(in_shape.scene(&bounds, budget)?, file, &models, budget)?;
    let threads = Threads::Count(options.threads as usize);
    // The caches take what is left of the budget, so the picture's share is set aside first.
    let picture_bytes = Renderer::bytes_needed_for(&models, &scene, &options.settings, &threads)?;
    let set_aside = budget.reserve(picture_bytes, "the picture")?;
    let octree_options = crate::octree_options(options, TreeQuality::Best);
    let mut instances = Instances::open(&sources, places, budget, &octree_options)?;
    drop(set_aside);
    instances.move_while_open(&file.movements())?;
    summary.placed(&instances, picture_bytes);
    let renderer = Renderer::over_instances(&instances, &scene, &options.settings, budget)?;
    let image = renderer.render(&threads, &mut crate::progress_of(meter, interrupt))?;
    Ok((image, compiled))
}

/// The scene with the pictures that the models' materials name. They are named from one folder.
fn with_textures(
    scene: Scene,
    file: &SceneFile,
    models: &[&Model],
    budget: &MemoryBudget,
) -> Result<Scene, Box<dyn Error>> {
    let has_images = |model: &&Model| !Textures::named_by(&model.materials).is_empty();
    let mut with_images = file.models.iter().zip(models).filter(|(_, model)| has_images(model));
    let Some((first, _)) = with_images.next() else { return Ok(scene) };
    if let Some((other, _)) = with_images.find(|(other, _)| other.file.parent() != first.file.parent()) {
        return Err(format!(
            "{} and {}: models with images must lie in one folder; move one with its images",
            first.file.display(),
            other.file.display()
        )
        .into());
    }
    let materials: Vec<_> = models.iter().flat_map(|model| model.materials.iter().cloned()).collect();
    crate::with_textures(scene, &materials, &first.file, budget)
}
