//! Measured costs and accesses of an image's cells, against each cell traced by itself.

mod support;

use std::collections::BTreeSet;
use std::fs::File;

use outcrop::access::AccessTrace;
use outcrop::error::TraceError;
use outcrop::geom::{Precision, Ray};
use outcrop::octree::OctreeOptions;
use outcrop::schedule::simulation::{AccessDetail, ClusterModel, CostModel, measure, sequential, simulate};
use outcrop::schedule::{ImageGrid, SchedulerOptions, TileCells};
use outcrop::trace::Tracer;
use outcrop::units::{Bytes, TileId};
use outcrop::{LazyOctree, MemoryBudget};

/// A wall of small triangles, each a little in front of the one before.
fn wall() -> support::Triangles {
    (0..2000u32)
        .map(|index| {
            let (x, y) = (f64::from(index % 50), f64::from(index / 50));
            [[x, y, 0.0], [x + 1.0, y, 0.25], [x, y + 1.0, 0.5]]
        })
        .collect()
}

const SIDE: u32 = 44;

/// Two rays of a pixel, one of them aslant; pixels of the last columns see nothing.
fn trace(tracer: &mut Tracer<'_>, [x, y]: [u32; 2]) -> Result<(), TraceError> {
    let (x, y) = (f64::from(x) * 1.25 + 0.3, f64::from(y) + 0.3);
    for direction in [[0.0, 0.0, -1.0], [0.9, 0.2, -0.3]] {
        tracer.closest_hit(&Ray::new([x, y, 9.0], direction))?;
    }
    Ok(())
}

#[test]
fn cells_cost_what_they_cost_alone() {
    let source = support::compile(&wall(), Precision::Float32, 40, |i| i as u64);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let mut octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
    // Tiles at the border lack cells.
    let grid = ImageGrid::new(SIDE, SIDE, 16, 4).unwrap();
    let model = CostModel::default();
    let directory = tempfile::tempdir().unwrap();
    for detail in [AccessDetail::Distinct, AccessDetail::Sequence] {
        let mut tiles = 0;
        let image = measure(&mut octree, &grid, detail, &model, &mut trace, &mut |_| tiles += 1).unwrap();
        assert_eq!(tiles, grid.tile_count());
        let mut entered = BTreeSet::new();
        for tile in (0..grid.tile_count()).map(TileId) {
            for cell in 0..grid.cells_per_tile() {
                let path = directory.path().join("cell");
                let recorder = octree.record_accesses(Box::new(File::create(&path).unwrap())).unwrap();
                let mut tracer = octree.tracer().unwrap();
                for (_, region) in grid.squares(TileCells { tile, cells: 1 << cell }, 1) {
                    for y in region.y..region.y + region.height {
                        for x in region.x..region.x + region.width {
                            trace(&mut tracer, [x, y]).unwrap();
                        }
                    }
                }
                let seconds = model.seconds(&tracer.counters());
                drop(tracer);
                recorder.finish().unwrap();
                let mut blocks = Vec::new();
                AccessTrace::open(&path).unwrap().visit_accesses(|_, block| match detail {
                    AccessDetail::Distinct if blocks.contains(&block) => {}
                    AccessDetail::Sequence if blocks.last() == Some(&block) => {}
                    _ => blocks.push(block),
                });
                assert!((image.seconds(tile, cell) - seconds).abs() <= 1e-6 * seconds, "{tile:?} {cell}");
                assert_eq!(image.accesses(tile, cell), blocks, "{tile:?} {cell}");
                assert_eq!(seconds == 0.0, grid.cells_of(tile) & 1 << cell == 0);
                entered.extend(blocks);
            }
        }
        let alone = sequential(&ClusterModel::default(), &image);
        assert_eq!(alone.blocks_touched, entered.len() as u64);
        assert!(entered.len() > 10 && image.blocks().len() >= entered.len());
        // The whole way: measured, then simulated.
        let report = simulate(&image, &ClusterModel::default(), SchedulerOptions::new(3), 3).unwrap();
        assert_eq!(report.schedule.cells_done, report.schedule.cells);
        assert!(report.loads >= alone.loads);
    }
}
