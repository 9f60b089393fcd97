//! The compiler: takes a mesh as a stream and leaves a compiled file.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::attributes::{Attributes, WrittenAttributes};
use super::blocks::{BlockMaker, BlockSettings};
use super::bucket::Bucket;
use super::clock::{Meter, Moment};
use super::crew::{Crew, batch_bytes, ended};
use super::faces::Faces;
use super::grid::{BucketMap, GRID_BYTES, Grid};
use super::lookup::{AsFloat32, AsLattice, Form};
use super::options::{
    CompileOptions, CompileReport, Control, Phase, PhaseSeconds, PrecisionChoice, Progress, Threads,
};
use super::output::Output;
use super::parallel::{Worker, encode_buckets};
use super::placer::Placer;
use super::point::Point;
use super::precision::{Decision, RoundingWatch, coarsest_lattice, shortest_square};
use super::refine::{refine, triangle_count};
use super::scatter::{self, Scatter, Scattered};
use super::spill::SpillPlace;
use super::temporary::{DiskQuota, directory_of, name_of};
use super::vertices::{Keep, VertexStore, unknown_vertex};
use crate::block::BlockLimits;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::CompileError;
use crate::geom::{Lattice, Precision};
use crate::import::{CornerIndices, MeshSink, VertexBatch};
use crate::model::{MaterialRecord, SourceRecord};
use crate::units::{Bytes, MaterialId};

/// Triangles per bucket, at two per vertex where their number is not known before the buckets are made.
const BUCKET_TRIANGLES: u64 = 64 << 10;
/// About how many triangles a block has.
const TRIANGLES_PER_BLOCK: u64 = 2500;
/// Small batches are gathered up to this many triangles.
const QUEUE_TRIANGLES: usize = 4096;
/// The callback is asked at least once in so many triangles.
const PROGRESS_TRIANGLES: u64 = 1 << 18;
/// About what cutting takes per thread for buckets of common size.
const WORKER_BYTES: u64 = 20 << 20;
/// Seen by nobody: who sets [`Keep::Rounded`] asks [`Compiler::needs`].
const NEEDS_EXACT: &str = "the automatic precision needs the vertices as they came";
/// Spill buffers: vertices (two), faces, chunks.
const SPILL_BUFFERS: u64 = 4 << 20;

/// Compiles a mesh that comes through [`MeshSink`], in memory bounded by the budget (I1).
///
/// Dropping it, at any time and for any reason, removes what it wrote; only [`Compiler::finish`] leaves a file.
pub struct Compiler<'p> {
    output: PathBuf,
    options: CompileOptions,
    budget: MemoryBudget,
    place: SpillPlace,
    pool: Option<Arc<rayon::ThreadPool>>,
    source: SourceRecord,
    materials: Vec<MaterialRecord>,
    store: VertexStore,
    /// The store while several threads read it; `store` is empty then.
    shared: Option<Arc<VertexStore>>,
    grid: Option<Grid>,
    stage: Stage,
    /// What is kept of f64 vertices.
    keep: Keep,
    /// Whether every vertex came as f32 or as text whose digits f32 keeps, so that the file can be `Float32` whatever the triangles are.
    all_float32: bool,
    /// Whether text was narrowed to f32 that would be needed if `all_float32` became false.
    narrowed: bool,
    watch: RoundingWatch,
    /// Whether `watch` has seen the triangles so far.
    watching: bool,
    /// What is missing of the vertices, once an error says so.
    needed: Option<Keep>,
    /// Whether something was taken in and lost to an error: a file of what is left would lack it.
    is_over: bool,
    queue: Vec<[u32; 3]>,
    queue_material: u16,
    triangles: u64,
    asked_at: u64,
    fraction: Option<f64>,
    progress: &'p mut dyn FnMut(Progress) -> Control,
    start: Moment,
    /// When the sink was last left.
    left: Moment,
    spill_bytes: u64,
    parse: Meter,
    scatter: Meter,
    grid_memory: Option<Reservation>,
    /// About how many triangles go into a bucket.
    bucket_triangles: u64,
    attributes: Attributes,
}

/// The buckets of a mesh that is complete, and what is known by then.
pub(super) struct Settled<P: Point> {
    pub(super) scattered: Scattered<P>,
    /// Has the memory of the last bucket that was parted.
    pub(super) worker: Worker<P>,
    pub(super) settings: BlockSettings,
    pub(super) decision: Decision,
    pub(super) error_bound: f64,
    /// Bytes that vertices and faces left on disk.
    pub(super) spill_bytes: u64,
    crew_time: Meter,
}

/// What becomes of the buckets.
pub(super) trait Ending {
    type Output;
    fn end<P: Point>(self, compiler: Compiler<'_>, settled: Settled<P>)
    -> Result<Self::Output, CompileError>;
}

/// What a compiler knows beside its buckets.
pub(super) struct Remains {
    pub(super) budget: MemoryBudget,
    pub(super) quota: DiskQuota,
    pub(super) options: CompileOptions,
    pub(super) source: SourceRecord,
    pub(super) materials: Vec<MaterialRecord>,
    pub(super) seconds: PhaseSeconds,
    /// Whether attributes of triangles were left out.
    pub(super) attributes_left_out: bool,
}

/// The time of an attempt that came to nothing.
pub(super) struct Spent {
    start: Moment,
    parse: Meter,
    scatter: Meter,
}

/// Where triangles go.
enum Stage {
    /// They wait: the grid or the precision is not known yet.
    Waiting(Box<Faces>),
    Narrow(Placer<[f32; 3]>),
    Lattice(Placer<[i64; 3]>, AsLattice),
    /// All were scattered.
    Done,
}

impl<'p> Compiler<'p> {
    /// A compiler that will write `output`. Nothing is written before it has to be.
    ///
    /// # Errors
    /// The budget is too small ([`CompileError::Budget`]) or an option makes no sense ([`CompileError::Limit`]).
    pub fn new(
        output: impl AsRef<Path>,
        options: CompileOptions,
        budget: &MemoryBudget,
        progress: &'p mut dyn FnMut(Progress) -> Control,
    ) -> Result<Compiler<'p>, CompileError> {
        let (start, output) = (Moment::now(), output.as_ref());
        let limits = BlockLimits { block_bytes_max: options.block_bytes };
        limits.validate().map_err(|reason| CompileError::Limit { reason: reason.to_string() })?;
        if !options.codec.is_available() {
            let reason = format!("this build lacks the codec {}", options.codec.name());
            return Err(CompileError::Limit { reason });
        }
        if let PrecisionChoice::Lattice { exponent } = options.precision
            && !(Lattice::EXPONENT_MIN..=Lattice::EXPONENT_MAX).contains(&exponent)
        {
            let reason = format!(
                "a lattice exponent must be within {} to {}, not {exponent}",
                Lattice::EXPONENT_MIN,
                Lattice::EXPONENT_MAX
            );
            return Err(CompileError::Limit { reason });
        }
        let pool = match &options.threads {
            Threads::One | Threads::Count(0 | 1) => None,
            Threads::Count(count) => {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(*count).build();
                let pool = pool.map_err(|error| CompileError::Limit { reason: error.to_string() })?;
                Some(Arc::new(pool))
            }
            // On one of the pool's own threads, waiting for the others could wait for ever.
            Threads::Pool(pool) => pool.current_thread_index().is_none().then(|| Arc::clone(pool)),
        };
        let place = SpillPlace {
            dir: options.spill_dir.clone().unwrap_or_else(|| directory_of(output)),
            name: name_of(output),
            quota: DiskQuota::new(options.disk_limit.map(|limit| limit.0)),
            budget: budget.clone(),
        };
        let grid_memory = budget.reserve(Bytes(GRID_BYTES), "the grid of vertex counts")?;
        let headroom = headroom(budget);
        // Faces are read once and in order, vertices again and again: memory is better spent on those.
        let faces = Faces::new(place.clone(), budget.limit().0 - budget.limit().0 / 8)?;
        Ok(Compiler {
            output: output.to_path_buf(),
            store: VertexStore::new(place.clone(), headroom),
            shared: None,
            stage: Stage::Waiting(Box::new(faces)),
            budget: budget.clone(),
            place,
            pool,
            source: SourceRecord::default(),
            materials: Vec::new(),
            grid: Some(Grid::new()),
            keep: match options.precision {
                PrecisionChoice::Auto => Keep::Both,
                PrecisionChoice::Float32 => Keep::Narrow,
                PrecisionChoice::Lattice { .. } => Keep::Exact,
            },
            all_float32: true,
            narrowed: false,
            watch: RoundingWatch::new(),
            watching: false,
            needed: None,
            is_over: false,
            queue: Vec::new(),
            queue_material: 0,
            triangles: 0,
            asked_at: 0,
            fraction: None,
            progress,
            start,
            left: Moment::now(),
            spill_bytes: 0,
            parse: Meter::default(),
            scatter: Meter::default(),
            grid_memory: Some(grid_memory),
            bucket_triangles: BUCKET_TRIANGLES,
            attributes: if options.attributes { Attributes::Kept(None) } else { Attributes::Unwanted },
            options,
        })
    }

    /// Records what the mesh is read from, so that a change can be noticed later.
    pub fn set_source(&mut self, source: SourceRecord) {
        self.source = source;
    }

    /// Leaves attributes out and notes whether there are any, unless they are not wanted anyway.
    pub(super) fn leave_attributes_out(&mut self) {
        if self.options.attributes {
            self.attributes = Attributes::LeftOut(false);
        }
    }

    /// About how many triangles shall go into a bucket.
    pub(super) fn set_bucket_triangles(&mut self, count: u64) {
        self.bucket_triangles = count.max(1);
    }

    /// Whether `Auto` turned out to need more of the vertices than was kept, and what; asked after an error.
    pub(super) fn needs(&self) -> Option<Keep> {
        self.needed
    }

    /// The error of vertices of which too little was kept.
    fn need(&mut self, keep: Keep) -> CompileError {
        self.needed = Some(keep);
        CompileError::Limit { reason: NEEDS_EXACT.into() }
    }

    /// The threads that the compile may use; they have nothing to do before the last vertex has come.
    pub(super) fn pool(&self) -> Option<&Arc<rayon::ThreadPool>> {
        self.pool.as_ref()
    }

    /// Ends an attempt; the time it took is for [`Compiler::add_spent`].
    pub(super) fn into_spent(mut self) -> Spent {
        self.parse.add_since(self.left);
        Spent { start: self.start, parse: self.parse, scatter: self.scatter }
    }

    /// Counts the time of an earlier attempt on the same thread.
    pub(super) fn add_spent(&mut self, spent: &Spent) {
        self.start = spent.start;
        self.parse.merge(&spent.parse);
        self.scatter.merge(&spent.scatter);
    }

    /// What `Auto` shall keep of vertices that are not f32. [`Keep::Narrow`] hopes for text that f32 keeps, [`Keep::Rounded`] for
    /// triangles that f32 is fine enough for: the mesh has to come once more if [`Compiler::needs`] says so.
    /// [`Keep::Exact`] knows that it will not be `Float32`.
    pub(super) fn set_keep(&mut self, keep: Keep) {
        if self.options.precision == PrecisionChoice::Auto {
            self.keep = keep;
            self.all_float32 = keep == Keep::Narrow;
        }
    }

    fn ask(&mut self, phase: Phase, fraction: Option<f64>) -> Result<(), CompileError> {
        self.asked_at = self.triangles;
        match (self.progress)(Progress { phase, fraction, triangles: self.triangles }) {
            Control::Continue => Ok(()),
            Control::Cancel => Err(CompileError::Cancelled),
        }
    }

    /// Runs sink work between two readings of the clock: what lies between such calls is the reader's time.
    fn timed<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, CompileError>,
    ) -> Result<T, CompileError> {
        if self.is_over {
            return Err(ended());
        }
        let entered = self.parse.add_since(self.left);
        let result = work(self);
        self.left = self.scatter.add_since(entered);
        self.is_over = result.is_err();
        result
    }

    /// Sends on what was gathered, so that [`Compiler::needs`] speaks for the whole mesh.
    pub(super) fn drain(&mut self) -> Result<(), CompileError> {
        self.drain_queue()?;
        self.timed(|compiler| compiler.watch_waiting(&[]))
    }

    /// Watches triangles that are to wait, if the precision depends on them, and before them those that wait already.
    fn watch_waiting(&mut self, triangles: &[[u32; 3]]) -> Result<(), CompileError> {
        let Stage::Waiting(faces) = &mut self.stage else { return Ok(()) };
        if self.all_float32 || self.options.precision != PrecisionChoice::Auto {
            return Ok(());
        }
        let (watch, store) = (&mut self.watch, &mut self.store);
        if !self.watching {
            self.watching = true;
            faces.replay(|triangles, _, _| watch.watch(triangles, store))?;
        }
        watch.watch(triangles, store)?;
        if watch.exceeded() && self.keep == Keep::Rounded {
            let needed = if watch.is_certain() { Keep::Exact } else { Keep::Both };
            return Err(self.need(needed));
        }
        Ok(())
    }

    /// Sends the queue on.
    fn drain_queue(&mut self) -> Result<(), CompileError> {
        if self.queue.is_empty() {
            return Ok(());
        }
        let queue = std::mem::take(&mut self.queue);
        let first_id = self.triangles - queue.len() as u64;
        let result = self.timed(|compiler| compiler.place(&queue, compiler.queue_material, first_id));
        self.queue = queue;
        self.queue.clear();
        result
    }

    /// Scatters triangles, or keeps them.
    fn place(&mut self, triangles: &[[u32; 3]], material: u16, first_id: u64) -> Result<(), CompileError> {
        self.watch_waiting(triangles)?;
        match &mut self.stage {
            Stage::Waiting(faces) => faces.push(triangles, material),
            Stage::Narrow(placer) => placer.add(triangles, material, first_id, &mut self.store, &AsFloat32),
            Stage::Lattice(placer, form) => placer.add(triangles, material, first_id, &mut self.store, form),
            Stage::Done => Ok(()),
        }
    }

    /// The precision, if it does not depend on triangles that are yet to come.
    fn early_decision(&self) -> Option<Decision> {
        let precision = match self.options.precision {
            PrecisionChoice::Float32 => Precision::Float32,
            PrecisionChoice::Lattice { exponent } => Precision::Lattice(Lattice { exponent }),
            PrecisionChoice::Auto if self.all_float32 => Precision::Float32,
            PrecisionChoice::Auto => return None,
        };
        Some(Decision { precision, tolerance_met: true })
    }

    /// Makes the buckets and begins to scatter: first the triangles that waited.
    fn begin_scatter(&mut self, precision: Precision) -> Result<(), CompileError> {
        // Only called while the grid is there and triangles wait.
        let (Some(grid), Stage::Waiting(faces)) = (self.grid.take(), &mut self.stage) else { return Ok(()) };
        let known = faces.count();
        let vertices = self.store.len() as u64;
        let vertices_max = match known {
            0 => self.bucket_triangles.div_ceil(2),
            known => (self.bucket_triangles as f64 * vertices as f64 / known as f64).ceil() as u64,
        };
        let map = Arc::new(grid.into_buckets(vertices_max));
        if precision == Precision::Float32 {
            self.spill_bytes += self.store.forget_exact();
        }
        let stage = match precision {
            Precision::Float32 => Stage::Narrow(self.placer(map, 1.0, AsFloat32)?),
            Precision::Lattice(lattice) => {
                let form = AsLattice::new(lattice);
                Stage::Lattice(self.placer(map, lattice.step(), form)?, form)
            }
        };
        let Stage::Waiting(mut faces) = std::mem::replace(&mut self.stage, stage) else { return Ok(()) };
        let total = known.max(1) as f64;
        if known > 0 {
            self.ask(Phase::Scatter, Some(0.0))?;
        }
        faces.replay(|triangles, material, first_id| {
            let before = first_id / PROGRESS_TRIANGLES;
            if (first_id + triangles.len() as u64) / PROGRESS_TRIANGLES != before {
                self.ask(Phase::Scatter, Some(first_id as f64 / total))?;
            }
            self.place(triangles, material, first_id)
        })?;
        self.spill_bytes += faces.spill_bytes();
        Ok(())
    }

    /// One scatter, or one for each thread if the vertices are all in memory.
    fn placer<F: Form>(
        &mut self,
        map: Arc<BucketMap>,
        unit: f64,
        form: F,
    ) -> Result<Placer<F::Point>, CompileError> {
        // What the cut needs later, beyond the memory of the vertices, which is free by then.
        let threads = self.pool.as_ref().map_or(1, |pool| pool.current_num_threads());
        let needed_later = (WORKER_BYTES * threads as u64).min(self.budget.limit().0 / 3);
        // Two triangles per vertex, if it is not known yet how many there are.
        let expected = self.triangles.max(2 * self.store.len() as u64);
        let share = self.budget.limit().0 / 12;
        // Vertices that are not all in memory do with little of it if faces are in any order. Where buckets are many and their
        // buffers small, the list of chunks would not find room otherwise.
        let [buffers, list] = scatter::bytes_needed(&map, share, expected);
        let needed_now = (buffers + list + SPILL_BUFFERS).min(self.budget.limit().0 / 2);
        self.store.leave(needed_now);
        let needed_later = needed_later + Output::directory_bytes(expected / TRIANGLES_PER_BLOCK);
        let headroom = (1 << 20) + needed_later.saturating_sub(self.store.memory_bytes() + GRID_BYTES);
        let skip = self.options.skip_not_finite;
        let make = |place: &SpillPlace, share: u64, count: u64| {
            Scatter::new(Arc::clone(&map), unit, place.clone(), share, (expected / count, headroom), skip)
        };
        if let Some(pool) = self.pool.clone()
            && self.store.is_resident()
            && let Ok(memory) = self.budget.reserve(Bytes(batch_bytes(threads)), "batches of triangles")
        {
            let count = threads as u64;
            let scatters: Result<Vec<_>, _> =
                (0..count).map(|_| make(&self.place, share / count, count)).collect();
            // Without the memory for several there may still be enough for one.
            if let Ok(scatters) = scatters {
                let empty = VertexStore::new(self.place.clone(), 0);
                let store = Arc::new(std::mem::replace(&mut self.store, empty));
                let crew = Crew::start(&pool, scatters, memory, &store, form);
                self.shared = Some(store);
                return Ok(Placer::Crew(Box::new(crew)));
            }
        }
        // The spill must not take what gathering may come to need.
        let scatter = make(&self.place, share, 1)?;
        let headroom = SPILL_BUFFERS + list.min(self.budget.limit().0 / 8);
        Ok(Placer::own(scatter, self.budget.clone(), headroom))
    }

    /// The vertices, whoever reads them.
    fn vertices_read(&self) -> &VertexStore {
        self.shared.as_deref().unwrap_or(&self.store)
    }

    /// Cuts, encodes and writes everything, seals the file and gives it its name. A file of that name is replaced in one step.
    ///
    /// # Errors
    /// [`CompileError`]; no file is left then, and one that had the name before is as it was.
    pub fn finish(self) -> Result<CompileReport, CompileError> {
        self.end(Publish)
    }

    /// Scatters what is left and hands the buckets on.
    pub(super) fn end<E: Ending>(mut self, ending: E) -> Result<E::Output, CompileError> {
        self.drain()?;
        self.left = self.parse.add_since(self.left);
        if self.triangles == 0 {
            return Err(CompileError::Empty);
        }
        let decision = match (self.early_decision(), &mut self.stage) {
            (Some(decision), _) => decision,
            (None, Stage::Waiting(faces))
                if self.watch.exceeded() || matches!(self.store, VertexStore::Exact(_)) =>
            {
                let mut shortest = self.watch.shortest_square();
                if self.watch.exceeded() {
                    faces.replay(|triangles, _, _| {
                        shortest = shortest_square(triangles, &mut self.store, shortest)?;
                        Ok(())
                    })?;
                }
                coarsest_lattice(shortest, self.grid.as_ref().map_or(0.0, Grid::magnitude_max))
            }
            (None, _) => Decision { precision: Precision::Float32, tolerance_met: true },
        };
        self.begin_scatter(decision.precision)?;
        match std::mem::replace(&mut self.stage, Stage::Done) {
            Stage::Narrow(placer) => {
                let (scattered, crew_time) = placer.finish(&mut self.store, &AsFloat32)?;
                let settled = self.settle(scattered, crew_time, decision)?;
                ending.end(self, settled)
            }
            Stage::Lattice(placer, form) => {
                let (scattered, crew_time) = placer.finish(&mut self.store, &form)?;
                let settled = self.settle(scattered, crew_time, decision)?;
                ending.end(self, settled)
            }
            Stage::Waiting(_) | Stage::Done => Err(CompileError::Empty),
        }
    }

    /// Frees the vertices, and parts buckets that came out too large.
    fn settle<P: Point>(
        &mut self,
        mut scattered: Scattered<P>,
        crew_time: Meter,
        decision: Decision,
    ) -> Result<Settled<P>, CompileError> {
        let spill_bytes = self.spill_bytes + self.vertices_read().spill_bytes();
        let error_bound = match decision.precision {
            Precision::Float32 => self.vertices_read().move_max(),
            Precision::Lattice(lattice) => lattice.error_bound(),
        };
        // The vertices are all in chunks now: their memory goes to the cut.
        self.store = VertexStore::new(self.place.clone(), 0);
        self.shared = None;
        self.grid_memory = None;

        let limits = BlockLimits { block_bytes_max: self.options.block_bytes };
        let settings = BlockSettings { precision: decision.precision, limits, codec: self.options.codec };
        let mut worker = Worker::new(settings);
        refine(&mut scattered, &mut worker.bucket, || self.ask(Phase::Scatter, None))?;
        self.left = self.scatter.add_since(self.left);
        Ok(Settled { scattered, worker, settings, decision, error_bound, spill_bytes, crew_time })
    }

    /// What is left when the buckets are elsewhere. `crew_time` is that of [`Settled`].
    pub(super) fn into_remains<P: Point>(mut self, settled: &Settled<P>) -> Remains {
        self.left = self.scatter.add_since(self.left);
        let mut scatter = self.scatter;
        scatter.merge(&settled.crew_time);
        let mut total = Meter::default();
        total.add_since(self.start);
        Remains {
            attributes_left_out: matches!(self.attributes, Attributes::LeftOut(true)),
            budget: self.budget,
            quota: self.place.quota,
            options: self.options,
            source: self.source,
            materials: self.materials,
            seconds: PhaseSeconds {
                parse: self.parse.seconds(),
                scatter: scatter.seconds(),
                total: total.seconds(),
                ..PhaseSeconds::default()
            },
        }
    }

    fn publish<P: Point>(mut self, settled: Settled<P>) -> Result<CompileReport, CompileError> {
        let Settled { scattered, worker: first, settings, decision, error_bound, mut spill_bytes, crew_time } =
            settled;
        let limits = settings.limits;
        // As many workers as there are threads, fewer if the budget does not hold so many.
        let (mut triangles, mut vertices) = (0, 0);
        for range in &scattered.buckets {
            let chunks = &scattered.chunks[range.clone()];
            triangles = triangles.max(triangle_count(chunks));
            vertices = vertices.max(chunks.iter().map(|chunk| u64::from(chunk.vertices)).sum());
        }
        let worker_bytes = Bucket::<P>::bytes_needed(triangles, vertices)
            + BlockMaker::<P>::bytes_needed(limits, triangles, vertices);
        let mut memory = vec![self.budget.reserve(Bytes(worker_bytes), "cutting a bucket")?];
        let mut workers = vec![first];
        let threads = self.pool.as_ref().map_or(1, |pool| pool.current_num_threads());
        while workers.len() < threads {
            match self.budget.reserve(Bytes(worker_bytes), "cutting a bucket") {
                Ok(reservation) => memory.push(reservation),
                Err(_) => break,
            }
            workers.push(Worker::new(settings));
        }

        let quota = self.place.quota.clone();
        let mut output = Output::create(&self.output, quota, decision.precision, limits, &self.budget)?;
        let mut write = Meter::default();
        let total = scattered.buckets.len().max(1) as f64;
        let mut done = 0;
        let pool = self.pool.clone();
        let cut_time = encode_buckets(&scattered, workers, pool.as_deref(), |bucket| {
            let start = Moment::now();
            output.write_bucket(bucket)?;
            write.add_since(start);
            done += 1;
            self.ask(Phase::Cut, Some(f64::from(done) / total))
        })?;
        drop(memory);
        let start = Moment::now();
        if output.triangles() == 0 {
            return Err(CompileError::Empty);
        }
        spill_bytes += scattered.spill_bytes();
        let skipped = scattered.skipped;
        drop(scattered);
        self.ask(Phase::Seal, None)?;
        let mut attributes = WrittenAttributes::default();
        if let Attributes::Kept(Some(store)) = std::mem::replace(&mut self.attributes, Attributes::Unwanted) {
            spill_bytes += store.spill_bytes();
            attributes = store.write(settings.codec, &mut output, &self.budget)?;
        }
        let compiled = self.options.precision.record(decision.tolerance_met, skipped);
        let written = output.seal(&self.materials, self.source, compiled)?;
        write.add_since(start);
        let mut total = Meter::default();
        total.add_since(self.start);
        let mut scatter = self.scatter;
        scatter.merge(&crew_time);
        let mut seconds = PhaseSeconds {
            parse: self.parse.seconds(),
            scatter: scatter.seconds(),
            cut: cut_time.cut.seconds(),
            encode: cut_time.encode.seconds(),
            write: write.seconds(),
            total: total.seconds(),
        };
        if pool.is_some() {
            // The workers' time is not in the calling thread's.
            seconds.total.cpu += crew_time.seconds().cpu + seconds.cut.cpu + seconds.encode.cpu;
        }
        Ok(CompileReport {
            skipped,
            triangles_with_attributes: attributes.triangles,
            attribute_bytes: attributes.bytes,
            seconds,
            spill_bytes,
            budget_peak: self.budget.peak(),
            ..written.report(decision, error_bound, self.options.codec)
        })
    }
}

impl MeshSink for Compiler<'_> {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        let id = u16::try_from(self.materials.len())
            .map_err(|_| CompileError::Limit { reason: "the model has more than 65,536 materials".into() })?;
        self.materials.push(material);
        Ok(MaterialId(id))
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        let headroom = headroom(&self.budget);
        self.timed(|compiler| {
            let Some(grid) = &mut compiler.grid else {
                return Err(CompileError::Limit { reason: "a vertex came after the last one".into() });
            };
            let count = match batch {
                VertexBatch::Float32(items) => {
                    grid.count(items.iter().map(|vertex| vertex.map(f64::from)));
                    items.len()
                }
                VertexBatch::Float64(items) | VertexBatch::Float32Text(items) => {
                    grid.count(items.iter().copied());
                    items.len()
                }
            };
            if compiler.store.len() as u64 + count as u64 > u64::from(u32::MAX) {
                let reason = "the model has more than 2^32 - 1 vertices; split it".into();
                return Err(CompileError::Limit { reason });
            }
            match batch {
                VertexBatch::Float32(_) => {}
                VertexBatch::Float32Text(_) => compiler.narrowed |= compiler.keep == Keep::Narrow,
                VertexBatch::Float64(_) => {
                    if compiler.narrowed && compiler.options.precision == PrecisionChoice::Auto {
                        return Err(compiler.need(Keep::Rounded));
                    }
                    compiler.all_float32 = false;
                    if compiler.keep == Keep::Narrow {
                        compiler.keep = Keep::Rounded;
                    }
                }
            }
            compiler.store.extend(batch, compiler.keep, &compiler.place, headroom)
        })
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        self.drain_queue()?;
        self.timed(|compiler| match compiler.early_decision() {
            Some(decision) => compiler.begin_scatter(decision.precision),
            None => Ok(()),
        })
    }

    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError> {
        match (u32::try_from(vertex), &self.shared) {
            (Ok(vertex), Some(store)) if (vertex as usize) < store.len() => {
                Ok(store.position_resident(vertex))
            }
            (Ok(vertex), None) if (vertex as usize) < self.store.len() => self.store.position(vertex),
            _ => Err(unknown_vertex(vertex)),
        }
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError> {
        let count = self.vertices_read().len();
        // No vertex is above the bits of all together, which are quicker to have than the highest.
        let bits = triangles.as_flattened().iter().fold(0, |bits, vertex| bits | *vertex);
        if bits as usize >= count {
            let highest = triangles.as_flattened().iter().fold(0, |highest, vertex| *vertex.max(&highest));
            if !triangles.is_empty() && highest as usize >= count {
                return Err(unknown_vertex(u64::from(highest)));
            }
        }
        if material.0 != self.queue_material {
            self.drain_queue()?;
            self.queue_material = material.0;
        }
        if triangles.len() < QUEUE_TRIANGLES {
            if self.queue.len() + triangles.len() > QUEUE_TRIANGLES {
                self.drain_queue()?;
            }
            self.queue.extend_from_slice(triangles);
            self.triangles += triangles.len() as u64;
        } else {
            self.drain_queue()?;
            let first_id = self.triangles;
            self.triangles += triangles.len() as u64;
            self.timed(|compiler| compiler.place(triangles, material.0, first_id))?;
        }
        if self.triangles - self.asked_at >= PROGRESS_TRIANGLES {
            self.ask(Phase::Read, self.fraction)?;
        }
        Ok(())
    }

    fn takes_attributes(&self) -> bool {
        !matches!(self.attributes, Attributes::Unwanted)
    }

    fn texture_coordinates(&mut self, batch: &[[f32; 2]]) -> Result<(), CompileError> {
        self.timed(|compiler| compiler.attributes.uvs(batch, &compiler.place))
    }

    fn normals(&mut self, batch: &[[f32; 3]]) -> Result<(), CompileError> {
        self.timed(|compiler| compiler.attributes.normals(batch, &compiler.place))
    }

    fn triangles_with_attributes(
        &mut self,
        triangles: &[[u32; 3]],
        corners: CornerIndices<'_>,
        material: MaterialId,
    ) -> Result<(), CompileError> {
        for list in [corners.uvs, corners.normals].into_iter().flatten() {
            if list.len() != triangles.len() {
                let reason = "triangles came with a list of attributes of another length".into();
                return Err(CompileError::Limit { reason });
            }
        }
        let (first_id, count) = (self.triangles, triangles.len());
        self.triangles(triangles, material)?;
        self.timed(|compiler| compiler.attributes.triangles(first_id, count, corners, &compiler.place))
    }

    fn progress(&mut self, consumed_bytes: u64, total_bytes: Option<u64>) -> Result<(), CompileError> {
        let part = |total: u64| if total > 0 { (consumed_bytes as f64 / total as f64).min(1.0) } else { 1.0 };
        self.fraction = total_bytes.map(part);
        self.ask(Phase::Read, self.fraction)
    }
}

/// Cuts all buckets and publishes the compiled file.
struct Publish;

impl Ending for Publish {
    type Output = CompileReport;

    fn end<P: Point>(
        self,
        compiler: Compiler<'_>,
        settled: Settled<P>,
    ) -> Result<CompileReport, CompileError> {
        compiler.publish(settled)
    }
}

/// What pages must leave in the budget for the rest of the scatter.
fn headroom(budget: &MemoryBudget) -> u64 {
    budget.limit().0 / 10 + SPILL_BUFFERS
}

impl std::fmt::Debug for Compiler<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Compiler")
            .field("output", &self.output)
            .field("options", &self.options)
            .field("triangles", &self.triangles)
            .finish_non_exhaustive()
    }
}
