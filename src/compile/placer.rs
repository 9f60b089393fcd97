//! The three ways of placing triangles: straight from memory or pages, by a crew of threads, or gathered.

use super::clock::Meter;
use super::crew::Crew;
use super::gather::{FetchWatch, FlushAll, Gather, PlaceGathered};
use super::lookup::Form;
use super::point::Point;
use super::scatter::{AddBatch, FinishScatter, Scatter, Scattered};
use super::vertices::VertexStore;
use crate::budget::MemoryBudget;
use crate::error::CompileError;

/// Scatter on the calling thread, or by a crew.
pub(super) enum Placer<P: Point> {
    /// Here.
    Own(Box<Own<P>>),
    /// By others; they have the vertices.
    Crew(Box<Crew<P>>),
}

/// Scatter on the calling thread.
pub(super) struct Own<P> {
    scatter: Scatter<P>,
    watch: FetchWatch,
    /// Once looking up page by page has gone wrong.
    gather: Option<Gather<P>>,
    budget: MemoryBudget,
    /// What a gathered batch must leave in the budget.
    headroom: u64,
}

impl<P: Point> Placer<P> {
    pub(super) fn own(scatter: Scatter<P>, budget: MemoryBudget, headroom: u64) -> Placer<P> {
        Placer::Own(Box::new(Own { scatter, watch: FetchWatch::default(), gather: None, budget, headroom }))
    }

    /// Places a batch of triangles; `store` is asked only if no crew has it.
    pub(super) fn add<F: Form<Point = P>>(
        &mut self,
        triangles: &[[u32; 3]],
        material: u16,
        first_id: u64,
        store: &mut VertexStore,
        form: &F,
    ) -> Result<(), CompileError> {
        match self {
            Placer::Own(own) => own.add(triangles, material, first_id, store, form),
            Placer::Crew(crew) => crew.add(triangles, material, first_id),
        }
    }

    /// All buckets, and the time that a crew spent.
    pub(super) fn finish<F: Form<Point = P>>(
        self,
        store: &mut VertexStore,
        form: &F,
    ) -> Result<(Scattered<P>, Meter), CompileError> {
        match self {
            Placer::Own(mut own) => {
                own.place_gathered(store, form)?;
                Ok((store.serve(form, FinishScatter(own.scatter))?, Meter::default()))
            }
            Placer::Crew(crew) => crew.finish(),
        }
    }
}

impl<P: Point> Own<P> {
    fn add<F: Form<Point = P>>(
        &mut self,
        mut triangles: &[[u32; 3]],
        material: u16,
        mut first_id: u64,
        store: &mut VertexStore,
        form: &F,
    ) -> Result<(), CompileError> {
        let Own { scatter, watch, gather, .. } = self;
        let Some(gather) = gather else {
            store.serve(form, AddBatch { scatter, triangles, material, first_id })?;
            if watch.is_thrashing(triangles.len(), store) {
                // What is in buckets names vertices of the store; from here on buckets name gathered ones.
                store.serve(form, FlushAll(scatter))?;
                store.shrink();
                self.gather = Some(Gather::new(store.len(), &self.budget, self.headroom)?);
            }
            return Ok(());
        };
        loop {
            let count = gather.push(triangles, material, first_id);
            triangles = &triangles[count..];
            first_id += count as u64;
            if triangles.is_empty() {
                return Ok(());
            }
            store.serve(form, PlaceGathered { gather, scatter })?;
        }
    }

    fn place_gathered<F: Form<Point = P>>(
        &mut self,
        store: &mut VertexStore,
        form: &F,
    ) -> Result<(), CompileError> {
        match self.gather.take() {
            Some(mut gather) => {
                store.serve(form, PlaceGathered { gather: &mut gather, scatter: &mut self.scatter })
            }
            None => Ok(()),
        }
    }
}
