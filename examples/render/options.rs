//! The command line of `render`.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::thread;

use outcrop::block::Codec;
use outcrop::cache::Policy;
use outcrop::compile::PrecisionChoice;
use outcrop::import::GltfPart;
use outcrop::octree::{LeafLayout, Tier, TreeQuality};
use outcrop::procedural::Gears;
use outcrop::render::{ImageFormat, RenderSettings, WaitingRays};
use outcrop::scene_file::SceneFile;
use outcrop::simd::SimdLevel;
use outcrop::units::Bytes;

use crate::common::arguments::Arguments;
use crate::common::gears_view;
use crate::{compiled, files};

pub const HELP: &str = "\
render: makes a picture of a model inside a memory budget

    cargo run --release --example render                      procedural gears, 1.7 million triangles, in 64 MiB
    cargo run --release --example render -- MODEL [OPTION]... .obj, .ply, .stl (each also .gz), .gltf, .glb or a compiled .outcrop
    cargo run --release --example render -- SCENE.toml [OPTION]...   a scene (docs/scene-file.md)
    cargo run --release --example render -- MODEL --compile-only [-o FILE.outcrop]

Without a MODEL, gears are made in code and go straight into the compiler, however many they are.
A model is compiled to MODEL.outcrop, unless that file is there and the model has not changed since: as far as the picture needs it,
or all of it at once with --compile-only or --recompile. What is compiled so far is kept in MODEL.outcrop.working,
images of its materials in MODEL.outcrop.tiles; both are beside the file that --compiled names if it does.

model
    --gears N               wheels per edge of the gears that are made without a MODEL (4): 27,456 N^3 + 96 triangles
picture
    -o, --output FILE       .png, .exr or .pfm; MODEL.png in the current folder if not given
    --layers                write depth, normal, triangle, material, albedo, samples and costs of each pixel too, as channels of the .exr file that -o
                            names; rays of different pixels are then not traced together, which takes longer
    --size WxH              512x512 (gears 768x768); one number for a square
    --spp N                 samples per pixel (1)
    --eye X,Y,Z             camera; chosen to show the whole model if not given
    --look-at X,Y,Z         the model's middle if not given
    --up X,Y,Z              what is upward in the picture (0,0,1 with --eye)
    --fov DEGREES           vertical angle of view (45; 40 if the camera is chosen)
    --orthographic HEIGHT   parallel projection, HEIGHT units from top to bottom
    --light X,Y,Z[,I]       point light of intensity I (1); may be repeated; chosen to suit the camera if not given
    --depth-bound X         follow rays while they can add more than X to a sample (0.001; 0 follows all)
resources
    --memory BYTES          budget of everything together, as in 64MiB (256MiB; gears 64MiB)
    --threads N             all of the machine's if not given
    --source KIND           disk (reads that leave no page cache), cached, mmap or memory (disk)
    --slots N               at most N cache slots
    --waiting N             at most N rays wait for blocks that are not in the cache while others are traced; auto or never (auto:
                            where there are fewer slots than blocks, and interreflection)
    --loaders N             threads beside the others that load blocks for rays that wait (0)
    --keep-free BYTES       let the cache follow the system's free memory and leave so much to others
    --policy KIND           which block makes room: lru, clock or s3-fifo (lru)
    --leaves KIND           expanded or indexed; by the budget if not given
    --trees KIND            quick to build, best to trace, or finest: slower to build, for many rays on a model that stays in
                            memory (best unless the model is compiled lazily)
    --simd KIND             avx2 or portable; the best here if not given
    --tier KIND             how sure hits are: fast, watertight, double, certified or exact (certified)
compiled file
    --compile-only          stop after compiling; -o then names the compiled file
    --compiled FILE         keep the compiled file there instead of beside the model
    --recompile             compile even if the compiled file is up to date
    --copies                write meshes that a glTF file places more than once out in the compiled file, instead of sharing one of each;
                            done anyway where sharing saves little, and with --compile-only, --compiled, --lazy, --record-accesses, --tier, --waiting and --loaders
    --lazy                  compile only what rays reach, and keep it in FILE.outcrop.working for the next time; done anyway
                            for a picture of a model that is not compiled, unless another option needs or asks for a compiled file
    --block-bytes BYTES     decoded size of a block, 4KiB to 256KiB (64KiB)
    --codec KIND            raw, lzo, lz4 or zstd (lz4; zstd in a build with that feature)
    --precision KIND        auto, float32, or the exponent E of a lattice of spacing 2^E (auto)
    --skip-not-finite       leave triangles with a NaN or infinite coordinate out, and count them, instead of failing
report
    --stats FILE.json       everything that is printed and more
    --record-accesses FILE  which blocks each query enters, and how much memory the view needs
    --memory-log FILE.csv   memory over time, and a plot of it as FILE.svg

Exit codes: 0 done, 1 failed, 130 stopped by ^C. What is finished of the picture by then is written: to its own name if nothing has that name,
else to NAME.partial.EXT. A second ^C ends at once.
";

/// What was asked for.
pub enum Command {
    Help,
    Run(Box<Options>),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SourceKind {
    Disk,
    Cached,
    Mmap,
    Memory,
}

#[derive(Clone)]
pub struct Options {
    /// What is said in a scene file, if one was given.
    pub scene: Option<SceneFile>,
    /// That file.
    pub scene_file: Option<PathBuf>,
    /// A model file or a compiled file; the gears if not given.
    pub model: Option<PathBuf>,
    /// Wheels per edge of those.
    pub gears_n: Option<u32>,
    /// The picture.
    pub output: PathBuf,
    /// Whether layers are written beside the colours.
    pub layers: bool,
    pub settings: RenderSettings,
    pub eye: Option<[f64; 3]>,
    pub look_at: Option<[f64; 3]>,
    pub up: Option<[f64; 3]>,
    pub fov: Option<f64>,
    pub orthographic: Option<f64>,
    /// Position and intensity.
    pub lights: Vec<([f64; 3], f32)>,
    pub memory: Bytes,
    pub threads: u32,
    pub source: SourceKind,
    pub slots_max: Option<u32>,
    pub waiting: Option<WaitingRays>,
    pub loaders: u32,
    pub policy: Policy,
    pub keep_free: Option<Bytes>,
    pub leaf_layout: LeafLayout,
    pub quality: Option<TreeQuality>,
    pub simd: Option<SimdLevel>,
    pub tier: Tier,
    pub compile_only: bool,
    pub compiled: Option<PathBuf>,
    pub recompile: bool,
    pub lazy: bool,
    /// Whether meshes of a glTF file are not shared.
    pub copies: bool,
    /// Which part of a glTF file `model` stands for.
    pub part: GltfPart,
    pub block_bytes: Option<u32>,
    pub codec: Option<Codec>,
    pub precision: Option<PrecisionChoice>,
    /// Whether triangles that are not finite are left out.
    pub skip_not_finite: bool,
    pub stats: Option<PathBuf>,
    pub record_accesses: Option<PathBuf>,
    pub memory_log: Option<PathBuf>,
}

/// What the command line says that counts before what a scene file says.
#[derive(Default)]
struct Given {
    output: Option<PathBuf>,
    size: Option<[u32; 2]>,
    samples: Option<u32>,
    contribution_bound: Option<f64>,
    memory: Option<Bytes>,
}

impl Options {
    /// Whether a compiled file is asked for that may not be there although one is.
    pub fn asks_to_compile(&self) -> bool {
        self.recompile || self.block_bytes.is_some() || self.codec.is_some() || self.precision.is_some()
    }

    /// Whether a model that is not compiled shall be compiled as rays reach it: if only its picture is wanted.
    pub fn is_lazy(&self) -> bool {
        let wants_file = self.compile_only
            || self.asks_to_compile()
            || self.record_accesses.is_some()
            || self.part != GltfPart::Scene;
        self.lazy || (!wants_file && self.source == SourceKind::Disk)
    }

    /// The glTF file, if meshes that it places more than once may be shared.
    pub fn shareable(&self) -> Option<&Path> {
        let is_for_one_model = self.copies
            || self.scene.is_some()
            || self.compile_only
            || self.compiled.is_some()
            || self.lazy
            || self.record_accesses.is_some()
            || self.asks_for_other_rays().is_some();
        self.model.as_deref().filter(|path| !is_for_one_model && is_gltf(path))
    }

    /// The option that rays through instances do not follow, if one is given: their hits are always certified, and they are traced in
    /// order.
    fn asks_for_other_rays(&self) -> Option<&'static str> {
        let given = [
            (self.tier != Tier::Certified, "--tier"),
            (matches!(self.waiting, Some(WaitingRays::Count(_))), "--waiting"),
            (self.loaders > 0, "--loaders"),
        ];
        given.into_iter().find_map(|(is_given, option)| is_given.then_some(option))
    }

    pub fn parse(mut arguments: Arguments) -> Result<Command, Box<dyn Error>> {
        let mut options = Options::default();
        let mut given = Given::default();
        while let Some(name) = arguments.option_or_model(&mut options.model)? {
            match name.as_str() {
                "-h" | "--help" => return Ok(Command::Help),
                "-o" | "--output" => given.output = Some(arguments.path()?),
                "--size" => given.size = Some(arguments.size()?),
                "--gears" => options.gears_n = Some(arguments.value()?),
                "--layers" => options.layers = true,
                "--spp" => given.samples = Some(arguments.value()?),
                "--eye" => options.eye = Some(arguments.numbers()?),
                "--look-at" => options.look_at = Some(arguments.numbers()?),
                "--up" => options.up = Some(arguments.numbers()?),
                "--fov" => options.fov = Some(arguments.value()?),
                "--orthographic" => options.orthographic = Some(arguments.value()?),
                "--light" => options.lights.push(light(&mut arguments)?),
                "--depth-bound" => given.contribution_bound = Some(arguments.value()?),
                "--memory" => given.memory = Some(arguments.value()?),
                "--threads" => options.threads = arguments.value()?,
                "--source" => {
                    let kinds = [
                        ("disk", SourceKind::Disk),
                        ("cached", SourceKind::Cached),
                        ("mmap", SourceKind::Mmap),
                        ("memory", SourceKind::Memory),
                    ];
                    options.source = arguments.choice(&kinds)?;
                }
                "--slots" => options.slots_max = Some(arguments.value()?),
                "--waiting" => options.waiting = Some(arguments.value()?),
                "--loaders" => options.loaders = arguments.value()?,
                "--keep-free" => options.keep_free = Some(arguments.value()?),
                "--policy" => {
                    options.policy = arguments.choice(&Policy::ALL.map(|kind| (kind.name(), kind)))?
                }
                "--leaves" => {
                    let kinds = [("expanded", LeafLayout::Expanded), ("indexed", LeafLayout::Indexed)];
                    options.leaf_layout = arguments.choice(&kinds)?;
                }
                "--trees" => {
                    let kinds = [
                        ("quick", TreeQuality::Quick),
                        ("best", TreeQuality::Best),
                        ("finest", TreeQuality::Finest),
                    ];
                    options.quality = Some(arguments.choice(&kinds)?);
                }
                "--simd" => {
                    let kinds = [("avx2", SimdLevel::Avx2), ("portable", SimdLevel::Portable)];
                    options.simd = Some(arguments.choice(&kinds)?);
                }
                "--tier" => options.tier = arguments.choice(&Tier::ALL.map(|tier| (tier.name(), tier)))?,
                "--compile-only" => options.compile_only = true,
                "--compiled" => options.compiled = Some(arguments.path()?),
                "--recompile" => options.recompile = true,
                "--copies" => options.copies = true,
                "--lazy" => options.lazy = true,
                "--block-bytes" => {
                    let bytes: Bytes = arguments.value()?;
                    // What does not fit is far too large, and refused as such.
                    options.block_bytes = Some(u32::try_from(bytes.0).unwrap_or(u32::MAX));
                }
                "--codec" => {
                    options.codec = Some(arguments.choice(&Codec::ALL.map(|kind| (kind.name(), kind)))?);
                }
                "--precision" => {
                    options.precision = Some(match arguments.text()?.as_str() {
                        "auto" => PrecisionChoice::Auto,
                        "float32" => PrecisionChoice::Float32,
                        exponent => match exponent.parse() {
                            Ok(exponent) => PrecisionChoice::Lattice { exponent },
                            Err(_) => {
                                return Err(format!(
                                    "--precision: `{exponent}` is not auto, float32 or a whole number"
                                )
                                .into());
                            }
                        },
                    });
                }
                "--skip-not-finite" => options.skip_not_finite = true,
                "--stats" => options.stats = Some(arguments.path()?),
                "--record-accesses" => options.record_accesses = Some(arguments.path()?),
                "--memory-log" => options.memory_log = Some(arguments.path()?),
                _ => return Err(arguments.unknown()),
            }
        }
        options.finish(given)?;
        Ok(Command::Run(Box::new(options)))
    }

    /// Fills in what depends on several options, and checks what can be checked before any work.
    fn finish(&mut self, given: Given) -> Result<(), Box<dyn Error>> {
        if self.threads == 0 {
            return Err("--threads 0: at least one is needed".into());
        }
        if self.slots_max == Some(0) {
            return Err("--slots 0: at least one is needed".into());
        }
        if self.up.is_some_and(|up| up == [0.0; 3]) {
            return Err("--up 0,0,0: a direction is needed, as 0,0,1".into());
        }
        if self.orthographic.is_some() && self.fov.is_some() {
            return Err(
                "--orthographic and --fov: a parallel projection has no angle of view; give one of them"
                    .into(),
            );
        }
        if self.model.is_none() {
            self.show_gears();
        } else if self.gears_n.is_some() {
            return Err("--gears: only without a MODEL".into());
        }
        let file = self.model.clone();
        if file.as_deref().and_then(Path::extension).is_some_and(|kind| kind == "toml") {
            self.read_scene()?;
        }
        self.refuse_for_compiled()?;
        if let Some([width, height]) = given.size {
            (self.settings.width, self.settings.height) = (width, height);
        }
        self.settings.samples_per_pixel = given.samples.unwrap_or(self.settings.samples_per_pixel);
        let bound = given.contribution_bound;
        self.settings.contribution_bound = bound.unwrap_or(self.settings.contribution_bound);
        self.memory = given.memory.unwrap_or(self.memory);
        self.settings.waiting = self.waiting.unwrap_or(self.settings.waiting);
        self.settings.loader_threads = self.loaders;
        if self.lazy && self.source != SourceKind::Disk {
            return Err(
                "--lazy reads what it keeps in its working file with --source disk; leave --source out"
                    .into(),
            );
        }
        if self.compile_only {
            if self.lazy {
                return Err("--lazy and --compile-only: a lazy compile only does what a picture needs; give one of them".into());
            }
            if given.output.is_some() && self.compiled.is_some() {
                return Err(
                    "-o and --compiled: both name the compiled file with --compile-only; give one of them"
                        .into(),
                );
            }
            self.compiled = given.output.or(self.compiled.take());
            return Ok(());
        }
        let of_scene = self.scene.as_ref().and_then(|scene| scene.output.clone());
        self.output =
            given.output.or(of_scene).unwrap_or_else(|| match file.as_deref().and_then(Path::file_stem) {
                Some(stem) => Path::new(stem).with_extension("png"),
                None => PathBuf::from("gears.png"),
            });
        let format = ImageFormat::of_path(&self.output)?;
        if self.layers {
            if format != ImageFormat::Exr {
                return Err(format!("--layers: {} is no .exr file", self.output.display()).into());
            }
            (self.settings.keep_statistics, self.settings.keep_costs) = (true, true);
        }
        Ok(())
    }

    /// Takes a scene file, which stands where the model would, for what it says.
    fn read_scene(&mut self) -> Result<(), Box<dyn Error>> {
        let Some(path) = self.model.take() else { return Ok(()) };
        // It is read before the other files are checked.
        files::refuse_irregular(&path)?;
        let scene = SceneFile::read(&path)?;
        self.scene_file = Some(path.clone());
        let has_view = self.eye.is_some()
            || self.look_at.is_some()
            || self.up.is_some()
            || self.fov.is_some()
            || self.orthographic.is_some();
        if has_view || !self.lights.is_empty() {
            return Err(format!(
                "{}: camera and lights are the scene file's; change them there",
                path.display()
            )
            .into());
        }
        if scene.instances().is_some() {
            self.refuse_for_instances(&path)?;
        }
        // There is one at least.
        self.model = scene.models.first().map(|model| model.file.clone());
        self.settings = scene.settings;
        self.memory = scene.memory.unwrap_or(self.memory);
        self.scene = Some(scene);
        Ok(())
    }

    /// What is for models that are not compiled. Scenes may hold both.
    fn refuse_for_compiled(&self) -> Result<(), Box<dyn Error>> {
        let has_many = self.scene.as_ref().is_some_and(|scene| scene.models.len() > 1);
        let Some(model) = self.model.as_deref().filter(|model| !has_many && compiled::is_compiled(model))
        else {
            return Ok(());
        };
        let given = [
            (self.compile_only, "--compile-only"),
            (self.recompile, "--recompile"),
            (self.lazy, "--lazy"),
            (self.block_bytes.is_some(), "--block-bytes"),
            (self.codec.is_some(), "--codec"),
            (self.precision.is_some(), "--precision"),
            (self.skip_not_finite, "--skip-not-finite"),
        ];
        match given.into_iter().find(|(is_given, _)| *is_given) {
            Some((_, option)) => Err(format!(
                "{option}: {} is a compiled file already; give the model that it was compiled from",
                model.display()
            )
            .into()),
            None => Ok(()),
        }
    }

    /// What is for one model only.
    fn refuse_for_instances(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let given = [
            (self.compiled.is_some(), "--compiled"),
            (self.compile_only, "--compile-only"),
            (self.record_accesses.is_some(), "--record-accesses"),
        ];
        let of_files = given.into_iter().find_map(|(is_given, option)| is_given.then_some(option));
        match of_files.or_else(|| self.asks_for_other_rays()) {
            Some(option) => {
                Err(format!("{option}: not for scenes of several models or places as {}", path.display())
                    .into())
            }
            None => Ok(()),
        }
    }

    /// What the gears are shown with where the command line leaves it open: their standard view.
    fn show_gears(&mut self) {
        (self.settings.width, self.settings.height) = (768, 768);
        self.memory = Bytes::mib(64);
        self.eye.get_or_insert(Gears::EYE);
        self.look_at.get_or_insert(gears_view::LOOK_AT);
        self.up.get_or_insert(gears_view::UP);
        if self.lights.is_empty() {
            self.lights = Gears::LAMPS.map(|position| (position, gears_view::INTENSITY)).to_vec();
        }
    }
}

impl Default for Options {
    fn default() -> Options {
        Options {
            scene: None,
            scene_file: None,
            model: None,
            gears_n: None,
            output: PathBuf::new(),
            layers: false,
            settings: RenderSettings::new(512, 512),
            eye: None,
            look_at: None,
            up: None,
            fov: None,
            orthographic: None,
            lights: Vec::new(),
            memory: Bytes::mib(256),
            threads: thread::available_parallelism().map_or(1, |count| count.get() as u32),
            source: SourceKind::Disk,
            slots_max: None,
            waiting: None,
            loaders: 0,
            policy: Policy::Lru,
            keep_free: None,
            leaf_layout: LeafLayout::Auto,
            quality: None,
            simd: None,
            tier: Tier::Certified,
            compile_only: false,
            compiled: None,
            recompile: false,
            lazy: false,
            copies: false,
            part: GltfPart::Scene,
            block_bytes: None,
            codec: None,
            precision: None,
            skip_not_finite: false,
            stats: None,
            record_accesses: None,
            memory_log: None,
        }
    }
}

/// Whether a file is glTF, by its name, in any case of letters as for the import.
pub fn is_gltf(path: &Path) -> bool {
    path.extension().is_some_and(|kind| ["gltf", "glb"].iter().any(|known| kind.eq_ignore_ascii_case(known)))
}

/// A position, and an intensity if there is a fourth number.
fn light(arguments: &mut Arguments) -> Result<([f64; 3], f32), Box<dyn Error>> {
    let numbers = arguments.number_list()?;
    match numbers[..] {
        [x, y, z] => Ok(([x, y, z], 1.0)),
        [x, y, z, intensity] => Ok(([x, y, z], intensity as f32)),
        _ => Err("--light: expected a position and perhaps an intensity, as in 1,2,3 or 1,2,3,0.5".into()),
    }
}
