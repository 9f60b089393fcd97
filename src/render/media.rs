//! Nested dielectrics: which bodies a ray is inside of, and which border it meets where several surfaces coincide.
//!
//! C. Schmidt and B. Budge, "Simple Nested Dielectrics in Ray Traced Images", JGT 2002: a body of higher priority displaces
//! those of lower, so a surface inside a stronger body is no border. In addition all surfaces at one place are taken
//! together: the water's surface that coincides with the glass is neither lost behind the offset of the next ray nor a
//! gap of air. Each surface counts once, at edges and vertices too, by the exact rule for crossings.

use super::counters::EffectCounters;
use super::query::RayQuery;
use super::stage::{Shader, Stage};
use crate::error::TraceError;
use crate::geom::{Ray, RayFrame, Sense};
use crate::trace::Hit;
use crate::units::{MaterialId, TriangleId};

/// The bodies that a ray is inside of, in the order in which it entered them. A body may be in it more than once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MediumStack {
    entries: [u16; MediumStack::DEPTH_MAX],
    len: u8,
}

impl MediumStack {
    /// Most bodies that overlap at one point and are told apart.
    pub const DEPTH_MAX: usize = 11;
    /// Outside of everything.
    pub const EMPTY: MediumStack = MediumStack { entries: [0; MediumStack::DEPTH_MAX], len: 0 };

    fn entries(&self) -> &[u16] {
        &self.entries[..usize::from(self.len)]
    }

    /// False if there is no room: the body is then not told apart.
    fn enter(&mut self, medium: MaterialId) -> bool {
        let Some(place) = self.entries.get_mut(usize::from(self.len)) else { return false };
        *place = medium.0;
        self.len += 1;
        true
    }

    /// False if the ray was not inside: it began there.
    fn leave(&mut self, medium: MaterialId) -> bool {
        let Some(place) = self.entries().iter().rposition(|entry| *entry == medium.0) else { return false };
        self.entries.copy_within(place + 1..usize::from(self.len), place);
        self.len -= 1;
        true
    }

    /// The body that counts: the one of highest priority, of equals the one entered last.
    pub fn top(&self, stage: &Stage) -> Option<MaterialId> {
        let media = self.entries().iter().map(|entry| MaterialId(*entry));
        media.max_by_key(|medium| stage.shader(*medium).priority)
    }
}

/// What the surfaces at a hit are to the ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Border {
    /// The body that the ray came through, and the one behind.
    pub before: Option<MaterialId>,
    pub after: Option<MaterialId>,
    /// What a ray that goes through is inside of.
    pub media: MediumStack,
    /// Bound on the distance, per axis, between the position of the hit and any of the surfaces.
    pub error: f64,
    /// Whether the hit is on a medium at all; otherwise only `before` means anything.
    pub is_medium: bool,
}

impl Border {
    /// Whether the ray stays in the same body: there is nothing to see.
    pub fn is_none(&self) -> bool {
        self.is_medium && self.before == self.after
    }
}

/// Surfaces at one place that are being gathered.
#[derive(Clone, Copy, Debug)]
struct Cluster {
    index: u32,
    /// Hits up to here are at the same place.
    t_max: f64,
    last: (f64, TriangleId),
    /// The surface that is shaded: the strongest that is crossed, unless something opaque lies there too.
    best: Option<Hit>,
    is_opaque: bool,
    first: Hit,
    /// Before and after, as far as known.
    came: MediumStack,
    media: MediumStack,
    error: f64,
}

/// `t` of a hit is off by a factor of up to `1 + 2^-40`, so hits within this may be at the same place.
const TOGETHER: f64 = 1.0 + 1.0 / (1u64 << 38) as f64;

/// Finds the borders of a batch of hits.
#[derive(Debug)]
pub(crate) struct Borders {
    pub borders: Vec<Border>,
    clusters: Vec<Cluster>,
    rays: Vec<Ray>,
    after: Vec<(f64, TriangleId)>,
    hits: Vec<Option<Hit>>,
}

impl Borders {
    pub fn new(capacity: usize) -> Borders {
        Borders {
            borders: Vec::with_capacity(capacity),
            clusters: Vec::with_capacity(capacity),
            rays: Vec::with_capacity(capacity),
            after: Vec::with_capacity(capacity),
            hits: vec![None; capacity],
        }
    }

    /// What [`Borders::new`] allocates.
    pub fn bytes_needed(capacity: usize) -> usize {
        capacity
            * (size_of::<Border>()
                + size_of::<Cluster>()
                + size_of::<Ray>()
                + size_of::<(f64, TriangleId)>()
                + size_of::<Option<Hit>>())
    }

    /// `times`: when each ray is traced, if instances move. Gathers what lies at each hit of a medium, and replaces the hit by that
    /// of the surface that is to be shaded.
    pub fn find(
        &mut self,
        stage: &Stage,
        query: &mut impl RayQuery,
        (rays, times): (&[Ray], &[f64]),
        media: impl Iterator<Item = MediumStack>,
        hits: &mut [Option<Hit>],
        counters: &mut EffectCounters,
    ) -> Result<(), TraceError> {
        self.borders.clear();
        self.clusters.clear();
        for ((index, came), (ray, hit)) in (0u32..).zip(media).zip(rays.iter().zip(hits.iter())) {
            let before = came.top(stage);
            self.borders.push(Border { before, after: before, media: came, error: 0.0, is_medium: false });
            let Some(hit) = hit else { continue };
            if !stage.shader(hit.material).is_medium {
                continue;
            }
            let mut cluster = Cluster {
                index,
                t_max: hit.t * TOGETHER + f64::MIN_POSITIVE,
                last: (hit.t, hit.triangle),
                best: None,
                is_opaque: false,
                first: *hit,
                came,
                media: came,
                error: 0.0,
            };
            cluster.take(stage, ray, hit, counters);
            self.clusters.push(cluster);
        }
        // The first passes of all clusters together, then the second ones, and so on.
        let mut waiting = self.clusters.len();
        while waiting > 0 {
            self.rays.clear();
            self.after.clear();
            for cluster in &self.clusters[..waiting] {
                let ray = rays[cluster.index as usize];
                self.rays.push(Ray { t_max: ray.t_max.min(cluster.t_max), ..ray });
                self.after.push(cluster.last);
            }
            if !times.is_empty() {
                query.at_times(
                    &mut self.clusters[..waiting].iter().map(|cluster| times[cluster.index as usize]),
                );
            }
            let found = &mut self.hits[..waiting];
            query.closest_hits_after(&self.rays, &self.after, found)?;
            counters.medium_rays += waiting as u64;
            let mut index = waiting;
            while index > 0 {
                index -= 1;
                match found[index] {
                    Some(hit) => self.clusters[index].take(stage, &self.rays[index], &hit, counters),
                    None => {
                        // Finished: to the end of those that wait.
                        waiting -= 1;
                        self.clusters.swap(index, waiting);
                        found.swap(index, waiting);
                        self.rays.swap(index, waiting);
                    }
                }
            }
        }
        for cluster in &self.clusters {
            let border = &mut self.borders[cluster.index as usize];
            border.before = cluster.came.top(stage);
            border.after = border.before;
            if let Some(hit) = cluster.best {
                hits[cluster.index as usize] = Some(hit);
            }
            if !cluster.is_opaque {
                border.after = cluster.media.top(stage);
                border.media = cluster.media;
                border.error = cluster.error;
                border.is_medium = true;
            }
        }
        Ok(())
    }
}

impl Cluster {
    /// Adds a surface at this place.
    fn take(&mut self, stage: &Stage, ray: &Ray, hit: &Hit, counters: &mut EffectCounters) {
        self.last = (hit.t, hit.triangle);
        let shader = stage.shader(hit.material);
        if !shader.is_medium {
            // Paint on glass. A veil there is not told from the glass.
            if shader.transmission_max == 0.0 && !self.is_opaque {
                self.is_opaque = true;
                self.best = Some(*hit);
            }
            return;
        }
        let (a, b) = (self.first.position(), hit.position());
        let apart = (0..3).fold(0.0f64, |most, axis| most.max((a[axis] - b[axis]).abs()));
        self.error = self.error.max(hit.position_error() + apart);
        let Some(sense) = RayFrame::new(ray).crossing(&hit.vertices) else { return };
        let room = match sense {
            Sense::Entry => self.media.enter(hit.material),
            Sense::Exit => {
                self.media.leave(hit.material) || {
                    // It began inside: so it was there all along.
                    self.came.enter(hit.material)
                }
            }
        };
        counters.medium_overflows += u64::from(!room);
        let is_stronger = |best: &Hit| shader.priority > stage.shader(best.material).priority;
        if !self.is_opaque && self.best.as_ref().is_none_or(is_stronger) {
            self.best = Some(*hit);
        }
    }
}
/// The refractive index on the ray's side over that on the other; none if light goes straight on.
pub(super) fn index_ratio(
    stage: &Stage,
    shader: &Shader,
    border: Option<&Border>,
    is_behind: bool,
) -> Option<f64> {
    let index = shader.refractive_index;
    match border {
        Some(border) if border.is_medium => {
            let index = |medium: Option<MaterialId>| medium.map_or(1.0, |m| stage.shader(m).refractive_index);
            let (before, after) = (index(border.before), index(border.after));
            (before != after).then(|| before / after)
        }
        _ if shader.transmission > 0.0 && index != 1.0 => Some(if is_behind { index } else { 1.0 / index }),
        _ => None,
    }
}
