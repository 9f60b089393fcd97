//! Turns every knob.

use std::error::Error;
use std::path::Path;

use outcrop::accuracy::sweep::{Measurement, Reference, Subject, pareto_front};
use outcrop::accuracy::{Certificate, Knobs, Metric, Sampling, TileThreshold};
use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Control, PrecisionChoice, Threads};
use outcrop::octree::{LeafLayout, OctreeOptions, Tier};
use outcrop::render::{Film, RenderSettings};
use outcrop::scene::Scene;
use outcrop::simd::SimdLevel;
use outcrop::units::TileId;

use crate::Options;
use crate::common::interrupt::Interrupt;
use crate::common::progress::Meter;
use crate::images;
use crate::model::{Model, Open, TRACERS_MAX, open, open_tier};

/// Everything that was found.
pub struct Report {
    pub model: String,
    pub size: u32,
    pub reference_samples: u32,
    pub reference_cut_off: f64,
    pub triangles: u64,
    pub threads: usize,
    pub certificate: Certificate,
    pub reference_seconds: f64,
    /// Pixels of the reference's check against the exact tier; it fails if one differs.
    pub exact_pixels: usize,
    /// One knob at a time.
    pub knobs: Vec<Knob>,
    /// Knobs together.
    pub combinations: Vec<Measurement>,
    /// Those that no other beats in RMSE, from the cheapest; measured again.
    pub front: Vec<Measurement>,
    /// Those that must not show, and how many pictures each was compared by.
    pub neutral: Vec<(&'static str, String)>,
    pub images: Vec<images::Pair>,
}

/// All values of one knob.
pub struct Knob {
    pub name: &'static str,
    /// What the isolated error is held against.
    pub base: &'static str,
    pub rows: Vec<Measurement>,
}

const CUT_OFF: f64 = 1e-3;
/// A base cut-off that does not show beside any other error.
const CUT_OFF_FINE: f64 = 1e-5;

struct Study<'a> {
    options: &'a Options,
    interrupt: &'a Interrupt,
    meter: &'a mut Meter,
    settings: RenderSettings,
    threads: Threads,
    reference: Reference,
    images: Vec<images::Pair>,
    done: usize,
}

pub fn run(options: &Options, interrupt: &Interrupt, meter: &mut Meter) -> Result<Report, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let model = Model::new(options.model.clone(), options.quick)?;
    let path = folder.path().join("model.outcrop");
    meter.set("compiling", 0.0);
    let compiled = model.compile(&path, CompileOptions::default())?;
    let settings = RenderSettings::new(options.size, options.size);
    let threads = Threads::Count(options.threads);

    let certified = open_tier(&path, Tier::Certified)?;
    let scene = model.scene(certified.source.as_ref())?;
    let subject = subject(&certified, &scene, &settings, &threads);
    let start = std::time::Instant::now();
    let before = outcrop::accuracy::sweep::processor_seconds(start);
    let reference =
        subject.reference(options.reference_samples, options.reference_cut_off, &mut |state| {
            let progress = state.progress;
            meter.set("reference", progress.samples as f64 / progress.samples_total.max(1) as f64);
            if interrupt.is_requested() { Control::Cancel } else { Control::Continue }
        })?;
    let reference_seconds = outcrop::accuracy::sweep::processor_seconds(start) - before;
    let mut study = Study {
        options,
        interrupt,
        meter,
        settings,
        threads: threads.clone(),
        reference,
        images: Vec::new(),
        done: 0,
    };
    let exact_pixels = study.check_against_exact(&path, &certified, &scene)?;
    let knobs = vec![
        study.tiers(&path, &scene)?,
        study.lattice(&model, folder.path(), &certified, &scene)?,
        study.samples(&certified, &scene)?,
        study.thresholds(&certified, &scene)?,
        study.cut_off(&certified, &scene)?,
        study.depth(&certified, &scene)?,
    ];
    let (combinations, front) = study.combinations(&path, &certified, &scene)?;
    let neutral = study.neutral(&model, folder.path(), &certified, &scene)?;
    let Study { reference, images, .. } = study;
    Ok(Report {
        model: model.name(),
        size: options.size,
        reference_samples: options.reference_samples,
        reference_cut_off: options.reference_cut_off,
        triangles: compiled.triangles,
        threads: options.threads,
        certificate: reference.certificate,
        reference_seconds,
        exact_pixels,
        knobs,
        combinations,
        front,
        neutral,
        images,
    })
}

fn subject<'a>(
    open: &'a Open,
    scene: &'a Scene,
    settings: &'a RenderSettings,
    threads: &'a Threads,
) -> Subject<'a> {
    Subject { octree: &open.octree, scene, settings, budget: &open.budget, threads }
}

fn adaptive(subject: &Subject<'_>, samples_max: u32, error: f64, contribution_bound: f64) -> Knobs {
    let thresholds = vec![TileThreshold { first_tile: TileId(0), error }];
    let sampling = Sampling::Adaptive { samples_min: 4, samples_max, confidence: 0.95, thresholds };
    Knobs { sampling, ..subject.fixed(1, contribution_bound) }
}

impl Study<'_> {
    /// The values of a list, or the first few.
    fn some<'l, T>(&self, list: &'l [T]) -> &'l [T] {
        if self.options.quick { &list[..list.len().min(3)] } else { list }
    }

    fn samples_base(&self) -> u32 {
        if self.options.quick { 2 } else { 8 }
    }

    fn measure(
        &mut self,
        open: &Open,
        scene: &Scene,
        name: [&str; 2],
        knobs: &Knobs,
        base: Option<&Film>,
        repetitions: u32,
    ) -> Result<(Measurement, Film), Box<dyn Error>> {
        self.done += 1;
        self.meter.set(&format!("{}: {} (picture {})", name[0], name[1], self.done), 0.0);
        let interrupt = self.interrupt;
        let subject = subject(open, scene, &self.settings, &self.threads);
        Ok(subject.measure(name, knobs, &self.reference, base, repetitions, &mut || {
            if interrupt.is_requested() { Control::Cancel } else { Control::Continue }
        })?)
    }

    fn show(&mut self, caption: &str, against: &Film, film: &Film) -> Result<(), Box<dyn Error>> {
        let index = self.images.len();
        self.images.push(images::write(&self.options.out, index, caption, against, film)?);
        Ok(())
    }

    /// One sample per pixel, all effects, in both tiers: every bit must be the same.
    fn check_against_exact(
        &mut self,
        path: &Path,
        certified: &Open,
        scene: &Scene,
    ) -> Result<usize, Box<dyn Error>> {
        let exact = open_tier(path, Tier::Exact)?;
        let films = [certified, &exact].map(|open| {
            let knobs = subject(open, scene, &self.settings, &self.threads).fixed(1, 1e-2);
            self.measure(open, scene, ["check", "exact tier"], &knobs, None, 1).map(|(_, film)| film)
        });
        let [a, b] = films;
        let (a, b) = (a?, b?);
        if a.pixels() != b.pixels() {
            return Err("the certified tier's picture is not the exact tier's: please report this".into());
        }
        Ok(a.pixels().len())
    }

    fn tiers(&mut self, path: &Path, scene: &Scene) -> Result<Knob, Box<dyn Error>> {
        let samples = if self.options.quick { 1 } else { 2 };
        let mut base = None;
        let mut rows = Vec::new();
        for tier in [Tier::Certified, Tier::Fast, Tier::Watertight, Tier::Double, Tier::Exact] {
            let open = open_tier(path, tier)?;
            let knobs = subject(&open, scene, &self.settings, &self.threads).fixed(samples, CUT_OFF);
            // Blocks are brought in before anything is timed; the exact tier is timed once, as nobody would render with it.
            self.measure(
                &open,
                scene,
                ["tier", "warm-up"],
                &Knobs { sampling: Sampling::Fixed { samples: 1 }, ..knobs.clone() },
                None,
                1,
            )?;
            let repetitions = if tier == Tier::Exact { 1 } else { self.options.repetitions };
            let (row, film) =
                self.measure(&open, scene, ["tier", tier.name()], &knobs, base.as_ref(), repetitions)?;
            rows.push(row);
            match &base {
                None => base = Some(film),
                Some(base) if tier == Tier::Fast => {
                    self.show("tier: fast against certified, same samples", base, &film)?
                }
                Some(_) => {}
            }
        }
        Ok(Knob { name: "tier", base: "certified, same samples", rows })
    }

    fn lattice(
        &mut self,
        model: &Model,
        folder: &Path,
        certified: &Open,
        scene: &Scene,
    ) -> Result<Knob, Box<dyn Error>> {
        let samples = self.samples_base();
        let knobs = subject(certified, scene, &self.settings, &self.threads).fixed(samples, CUT_OFF);
        let pixel = model.pixel(scene, certified.source.as_ref(), self.options.size);
        let (row, base) = self.measure(
            certified,
            scene,
            ["lattice step", "as compiled"],
            &knobs,
            None,
            self.options.repetitions,
        )?;
        let mut rows = vec![row];
        // In powers of two of a pixel.
        for below in self.some(&[2, 0, 4, 6, 8, 12, -2]) {
            let exponent = pixel.log2().round() as i32 - below;
            let path = folder.join("lattice.outcrop");
            let precision = PrecisionChoice::Lattice { exponent };
            model.compile(&path, CompileOptions { precision, ..CompileOptions::default() })?;
            let open = open_tier(&path, Tier::Certified)?;
            let name = format!("2^{exponent}, {} of a pixel", fraction(2f64.powi(exponent) / pixel));
            self.measure(
                &open,
                scene,
                ["lattice step", "warm-up"],
                &subject(&open, scene, &self.settings, &self.threads).fixed(1, CUT_OFF),
                None,
                1,
            )?;
            let (row, film) = self.measure(
                &open,
                scene,
                ["lattice step", &name],
                &knobs,
                Some(&base),
                self.options.repetitions,
            )?;
            rows.push(row);
            if *below == 2 {
                self.show(
                    &format!("lattice step {name} against the model as compiled, same samples"),
                    &base,
                    &film,
                )?;
            }
        }
        // From the coarsest step to the finest, and last the model as it was.
        rows.sort_by_key(|row| {
            row.value.strip_prefix("2^").map_or(i32::MAX, |text| {
                let exponent = text.split(',').next().and_then(|text| text.parse::<i32>().ok());
                -exponent.unwrap_or(0)
            })
        });
        Ok(Knob { name: "lattice step", base: "the model as compiled, same samples", rows })
    }

    fn samples(&mut self, certified: &Open, scene: &Scene) -> Result<Knob, Box<dyn Error>> {
        let mut rows = Vec::new();
        for samples in self.some(&[1, 4, 16, 2, 8, 32, 64, 128]) {
            let knobs =
                subject(certified, scene, &self.settings, &self.threads).fixed(*samples, CUT_OFF_FINE);
            let repetitions = if *samples > 16 { 1 } else { self.options.repetitions };
            let (row, film) = self.measure(
                certified,
                scene,
                ["samples per pixel", &samples.to_string()],
                &knobs,
                None,
                repetitions,
            )?;
            rows.push(row);
            if *samples == 4 {
                let reference = clone_of(&self.reference.film);
                self.images.push(images::write_pixels(
                    &self.options.out,
                    self.images.len(),
                    "4 samples per pixel against the reference",
                    &reference,
                    film.pixels(),
                    film.width(),
                )?);
            }
        }
        rows.sort_by_key(|row| row.value.parse::<u32>().unwrap_or(0));
        Ok(Knob { name: "samples per pixel", base: "", rows })
    }

    fn thresholds(&mut self, certified: &Open, scene: &Scene) -> Result<Knob, Box<dyn Error>> {
        let mut rows = Vec::new();
        for error in self.some(&[0.5, 0.2, 0.1, 0.05, 0.03, 0.02]) {
            let knobs = adaptive(
                &subject(certified, scene, &self.settings, &self.threads),
                1024,
                *error,
                CUT_OFF_FINE,
            );
            let name = error.to_string();
            let (row, film) = self.measure(
                certified,
                scene,
                ["adaptive threshold", &name],
                &knobs,
                None,
                self.options.repetitions,
            )?;
            rows.push(row);
            if *error == 0.1 {
                let reference = clone_of(&self.reference.film);
                self.images.push(images::write_pixels(
                    &self.options.out,
                    self.images.len(),
                    "adaptive sampling, threshold 0.1, against the reference",
                    &reference,
                    film.pixels(),
                    film.width(),
                )?);
            }
        }
        Ok(Knob { name: "adaptive threshold", base: "", rows })
    }

    fn cut_off(&mut self, certified: &Open, scene: &Scene) -> Result<Knob, Box<dyn Error>> {
        let samples = self.samples_base();
        let mut base: Option<Film> = None;
        let mut rows = Vec::new();
        for bound in self.some(&[1e-7, 1e-1, 1e-2, 3e-2, 3e-3, 1e-3, 1e-4, 1e-5]) {
            let knobs = subject(certified, scene, &self.settings, &self.threads).fixed(samples, *bound);
            let name = format!("{bound:e}");
            let (row, film) = self.measure(
                certified,
                scene,
                ["contribution cut-off", &name],
                &knobs,
                base.as_ref(),
                self.options.repetitions,
            )?;
            rows.push(row);
            match &base {
                None => base = Some(film),
                Some(base) if *bound == 1e-1 => {
                    self.show("cut-off 0.1 against 1e-7, same samples", base, &film)?
                }
                Some(_) => {}
            }
        }
        rows.sort_by(|a, b| parse(&b.value).total_cmp(&parse(&a.value)));
        Ok(Knob { name: "contribution cut-off", base: "a cut-off of 1e-7, same samples", rows })
    }

    fn depth(&mut self, certified: &Open, scene: &Scene) -> Result<Knob, Box<dyn Error>> {
        let samples = self.samples_base();
        let mut base: Option<Film> = None;
        let mut rows = Vec::new();
        for work_budget in self.some(&[1 << 14, 1, 8, 2, 4, 16, 64, 256]) {
            let fixed = subject(certified, scene, &self.settings, &self.threads).fixed(samples, CUT_OFF);
            let knobs = Knobs { work_budget: *work_budget, ..fixed };
            let name = work_budget.to_string();
            let (row, film) = self.measure(
                certified,
                scene,
                ["depth (rays per sample)", &name],
                &knobs,
                base.as_ref(),
                self.options.repetitions,
            )?;
            rows.push(row);
            base.get_or_insert(film);
        }
        rows.sort_by_key(|row| row.value.parse::<u64>().unwrap_or(0));
        Ok(Knob { name: "depth (rays per sample)", base: "16384 rays per sample, same samples", rows })
    }

    /// Every tier that is fast enough with every sampling and some cut-offs; the front is measured again.
    fn combinations(
        &mut self,
        path: &Path,
        certified: &Open,
        scene: &Scene,
    ) -> Result<(Vec<Measurement>, Vec<Measurement>), Box<dyn Error>> {
        let fast = open_tier(path, Tier::Fast)?;
        let mut all: Vec<(Measurement, Knobs, bool)> = Vec::new();
        let warm = subject(&fast, scene, &self.settings, &self.threads).fixed(1, CUT_OFF);
        self.measure(&fast, scene, ["combination", "warm-up"], &warm, None, 1)?;
        for (is_fast, open) in [(false, certified), (true, &fast)] {
            let subject = subject(open, scene, &self.settings, &self.threads);
            let mut choices: Vec<(String, Knobs)> = Vec::new();
            for bound in [1e-2, 1e-3] {
                for samples in self.some(&[1, 4, 2, 8, 16, 32, 64]) {
                    choices.push((
                        format!("{samples} samples, cut-off {bound:e}"),
                        subject.fixed(*samples, bound),
                    ));
                }
                for error in self.some(&[0.2, 0.5, 0.1, 0.05, 0.02]) {
                    choices.push((
                        format!("adaptive {error}, cut-off {bound:e}"),
                        adaptive(&subject, 1024, *error, bound),
                    ));
                }
            }
            for (name, knobs) in choices {
                let name = format!("{}, {name}", open.octree_tier());
                let (row, _) = self.measure(open, scene, ["combination", &name], &knobs, None, 1)?;
                all.push((row, knobs, is_fast));
            }
        }
        let points: Vec<[f64; 2]> =
            all.iter().map(|(row, ..)| [row.seconds_median(), row.error(Metric::Rmse)]).collect();
        let mut front = Vec::new();
        for index in pareto_front(&points) {
            let (row, knobs, is_fast) = &all[index];
            let open = if *is_fast { &fast } else { certified };
            let (again, _) = self.measure(
                open,
                scene,
                ["combination", &row.value],
                knobs,
                None,
                self.options.repetitions,
            )?;
            front.push(again);
        }
        Ok((all.into_iter().map(|(row, ..)| row).collect(), front))
    }

    /// What must not show: an error if it does.
    fn neutral(
        &mut self,
        model: &Model,
        folder: &Path,
        certified: &Open,
        scene: &Scene,
    ) -> Result<Vec<(&'static str, String)>, Box<dyn Error>> {
        let knobs = adaptive(&subject(certified, scene, &self.settings, &self.threads), 16, 0.1, CUT_OFF);
        let (_, base) = self.measure(certified, scene, ["neutral", "base"], &knobs, None, 1)?;
        let mut found = Vec::new();
        let mut compare = |study: &mut Study<'_>, what: &'static str, value: String, open: &Open| {
            let (_, film) = study.measure(open, scene, [what, &value], &knobs, None, 1)?;
            if film.pixels() != base.pixels() {
                return Err(format!("{what} {value} changes the picture: please report this").into());
            }
            found.push((what, value));
            Ok::<(), Box<dyn Error>>(())
        };
        let path = folder.join("model.outcrop");
        let blocks = certified.source.model().blocks.len() as u32;
        let default = OctreeOptions::default();
        for layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
            let open = open(&path, OctreeOptions { leaf_layout: layout, ..default })?;
            compare(self, "leaf layout", format!("{layout:?}").to_lowercase(), &open)?;
        }
        for share in [4, 16] {
            let slots = (blocks / share).max(TRACERS_MAX);
            let open = open(&path, OctreeOptions { slots_max: Some(slots), ..default })?;
            compare(self, "cache", format!("{slots} of {blocks} blocks"), &open)?;
        }
        let open = open(&path, OctreeOptions { simd: Some(SimdLevel::Portable), ..default })?;
        compare(self, "instructions", "portable".to_string(), &open)?;
        let precision = match certified.source.model().precision {
            outcrop::geom::Precision::Float32 => PrecisionChoice::Float32,
            outcrop::geom::Precision::Lattice(lattice) => {
                PrecisionChoice::Lattice { exponent: lattice.exponent }
            }
        };
        // A quarter of the triangles per block makes leaves of other sizes and other boxes around them, padded otherwise.
        let variants =
            [(4, Codec::Lz4), (16, Codec::Lz4), (256, Codec::Lz4), (64, Codec::Raw), (64, Codec::Lzo)];
        for (kib, codec) in variants {
            let path = folder.join("variant.outcrop");
            model.compile(
                &path,
                CompileOptions { block_bytes: kib << 10, codec, precision, ..CompileOptions::default() },
            )?;
            let open = open_tier(&path, Tier::Certified)?;
            let value =
                if codec == Codec::Lz4 { format!("{kib} KiB") } else { format!("{codec:?}").to_lowercase() };
            let what =
                if codec == Codec::Lz4 { "block size, with it leaves and their padding" } else { "codec" };
            compare(self, what, value, &open)?;
        }
        let threads = self.threads.clone();
        for count in [1, 3] {
            self.threads = Threads::Count(count);
            compare(self, "threads", count.to_string(), certified)?;
        }
        self.threads = threads;
        let settings = self.settings;
        for tile_size in [8, 64] {
            self.settings = RenderSettings { tile_size, batch_samples: 333, ..settings };
            let other = Knobs { tile_size, ..knobs.clone() };
            let (_, film) =
                self.measure(certified, scene, ["tile size", &tile_size.to_string()], &other, None, 1)?;
            if film.pixels() != base.pixels() {
                return Err(format!("tiles of {tile_size} change the picture: please report this").into());
            }
            found.push(("tile and batch size", tile_size.to_string()));
        }
        self.settings = settings;
        Ok(found)
    }
}

impl Open {
    fn octree_tier(&self) -> &'static str {
        self.octree.tier().name()
    }
}

fn clone_of(film: &Film) -> Vec<[f32; 3]> {
    film.pixels().to_vec()
}

fn parse(text: &str) -> f64 {
    text.parse().unwrap_or(0.0)
}

/// 4, 1/2 and the like.
fn fraction(x: f64) -> String {
    if x >= 0.75 { format!("{x:.1}") } else { format!("1/{:.0}", 1.0 / x) }
}
