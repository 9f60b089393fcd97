//! What a render did.

use super::counters::EffectCounters;
use super::json::{JsonObject, array};
use crate::cache::CacheStats;
use crate::scene::EffectPlan;
use crate::stats::TraceCounters;
use crate::units::Bytes;

/// Seconds by the clock, summed over the render's threads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkerSeconds {
    /// Closest hits of camera, reflection and transmission rays, block loads included.
    pub paths: f64,
    /// Shadow rays, block loads included.
    pub shadows: f64,
    /// Camera rays, shading, film.
    pub shading: f64,
}

impl WorkerSeconds {
    /// Adds `other` to every field.
    pub fn merge(&mut self, other: &WorkerSeconds) {
        self.paths += other.paths;
        self.shadows += other.shadows;
        self.shading += other.shading;
    }
}

/// How rays waited for blocks in a render ([`WaitingRays`](super::WaitingRays)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WaitingReport {
    /// Rays that could wait, all threads together.
    pub rays: u32,
    /// Threads that loaded blocks beside those that traced; 0 if these loaded for themselves.
    pub loader_threads: u32,
    /// Seconds by the clock, summed over the threads that trace, in which they did not because of loads.
    pub loading_seconds: f64,
    /// Of these, those in which they waited: for reads, for loaders, for other threads.
    pub stall_seconds: f64,
    /// Most loads that one thread had asked loaders for at one time.
    pub in_flight_peak: u32,
}

/// How a render ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Every tile is finished.
    Complete,
    /// The caller cancelled; some tiles are missing.
    Cancelled,
}

/// What a render did.
#[derive(Clone, Debug)]
pub struct RenderReport {
    /// Whether the picture is whole.
    pub outcome: Outcome,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Samples per pixel.
    pub samples_per_pixel: u32,
    /// Threads that were to render; if the system gave fewer, fewer did.
    pub threads: u32,
    /// Tiles of the picture.
    pub tiles_total: u32,
    /// Tiles that were finished.
    pub tiles_finished: u32,
    /// Seconds by the clock for the whole render.
    pub wall_seconds: f64,
    /// Seconds by phase.
    pub seconds: WorkerSeconds,
    /// Which effects were simulated, which were not needed, and why.
    pub plan: EffectPlan,
    /// Rays by effect, and what was cut.
    pub effects: EffectCounters,
    /// Work of the queries.
    pub trace: TraceCounters,
    /// What the geometry cache did during the render (other users of the same cache included).
    pub cache: CacheStats,
    /// Distinct blocks that a ray entered since the octree was opened.
    pub blocks_touched: u64,
    /// Blocks of the model.
    pub blocks_total: u64,
    /// What film, ray trees and tables took from the budget.
    pub memory: Bytes,
    /// Largest sum of reservations in the budget so far, other users included.
    pub budget_peak: Bytes,
    /// How rays waited for blocks; `None` if none did because of the settings, the scene, the model or the budget.
    pub waiting: Option<WaitingReport>,
}

impl RenderReport {
    /// Adds what was done before by a picture that this one went on with.
    pub(crate) fn add_before(&mut self, before: &RenderReport) {
        self.wall_seconds += before.wall_seconds;
        self.seconds.merge(&before.seconds);
        self.effects.merge(&before.effects);
        self.trace.merge(&before.trace);
        let (cache, earlier) = (&mut self.cache, &before.cache);
        cache.hits += earlier.hits;
        cache.misses += earlier.misses;
        cache.evictions += earlier.evictions;
        cache.stalls += earlier.stalls;
        cache.filled_bytes += earlier.filled_bytes;
        if let (Some(waiting), Some(earlier)) = (&mut self.waiting, &before.waiting) {
            waiting.loading_seconds += earlier.loading_seconds;
            waiting.stall_seconds += earlier.stall_seconds;
            waiting.in_flight_peak = waiting.in_flight_peak.max(earlier.in_flight_peak);
        }
    }

    /// Block loads per distinct block touched; 1 is the least possible for a cache that starts empty. 0 if nothing was touched.
    pub fn loads_per_touched_block(&self) -> f64 {
        if self.blocks_touched == 0 {
            return 0.0;
        }
        self.trace.blocks_loaded as f64 / self.blocks_touched as f64
    }

    /// The report as one JSON object; names as in the fields.
    pub fn to_json(&self) -> String {
        let effects = &self.effects;
        let rays = effects
            .fields()
            .into_iter()
            .fold(JsonObject::new(), |object, (name, count)| object.count(name, count))
            .end();
        let trace = &self.trace;
        let queries = JsonObject::new()
            .count("rays", trace.rays)
            .count("box_tests", trace.box_tests)
            .count("triangle_tests", trace.triangle_tests)
            .count("decisions", trace.decisions)
            .count("exact_fallbacks", trace.exact_fallbacks)
            .count("block_visits", trace.block_visits)
            .count("blocks_loaded", trace.blocks_loaded)
            .count("bytes_read", trace.bytes_read)
            .count("triangles_decoded", trace.triangles_decoded)
            .count("suspended_peak", trace.suspended_peak)
            .end();
        let cache = JsonObject::new()
            .count("hits", self.cache.hits)
            .count("misses", self.cache.misses)
            .count("evictions", self.cache.evictions)
            .count("stalls", self.cache.stalls)
            .count("filled_bytes", self.cache.filled_bytes)
            .end();
        let seconds = JsonObject::new()
            .number("paths", self.seconds.paths)
            .number("shadows", self.seconds.shadows)
            .number("shading", self.seconds.shading)
            .end();
        let plan = array(self.plan.decisions().iter().map(|decision| {
            JsonObject::new()
                .text("effect", decision.effect.name())
                .flag("needed", decision.needed)
                .text("reason", &decision.reason)
                .end()
        }));
        let waiting = match &self.waiting {
            None => "null".to_string(),
            Some(waiting) => JsonObject::new()
                .count("rays", waiting.rays.into())
                .count("loader_threads", waiting.loader_threads.into())
                .number("loading_seconds", waiting.loading_seconds)
                .number("stall_seconds", waiting.stall_seconds)
                .count("in_flight_peak", waiting.in_flight_peak.into())
                .end(),
        };
        JsonObject::new()
            .flag("complete", self.outcome == Outcome::Complete)
            .count("width", self.width.into())
            .count("height", self.height.into())
            .count("samples_per_pixel", self.samples_per_pixel.into())
            .count("threads", self.threads.into())
            .count("tiles_total", self.tiles_total.into())
            .count("tiles_finished", self.tiles_finished.into())
            .number("wall_seconds", self.wall_seconds)
            .raw("seconds", &seconds)
            .raw("plan", &plan)
            .raw("effects", &rays)
            .raw("trace", &queries)
            .raw("cache", &cache)
            .raw("waiting", &waiting)
            .count("blocks_touched", self.blocks_touched)
            .count("blocks_total", self.blocks_total)
            .number("loads_per_touched_block", self.loads_per_touched_block())
            .count("memory_bytes", self.memory.0)
            .count("budget_peak_bytes", self.budget_peak.0)
            .end()
    }
}
