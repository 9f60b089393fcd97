//! OpenEXR with the colour and every layer as channels of one part, compressed without loss.

use std::io::{self, Seek, Write};

use exr::prelude::*;

use crate::render::{Film, LayerPixel, Layers};

pub(super) fn encode(film: &Film, layers: &Layers, out: &mut (impl Write + Seek)) -> io::Result<()> {
    let colour =
        |channel: usize| FlatSamples::F32(film.pixels().iter().map(|pixel| pixel[channel]).collect());
    let real = |missing: f32, value: &dyn Fn(&LayerPixel) -> f32| {
        FlatSamples::F32(layers.pixels().iter().map(|pixel| pixel.as_ref().map_or(missing, value)).collect())
    };
    let whole = |value: &dyn Fn(&LayerPixel) -> u32| {
        FlatSamples::U32(layers.pixels().iter().map(|pixel| pixel.as_ref().map_or(u32::MAX, value)).collect())
    };
    let channels = [
        ("R", colour(0)),
        ("G", colour(1)),
        ("B", colour(2)),
        ("Z", real(f32::INFINITY, &|pixel| pixel.depth)),
        ("N.X", real(0.0, &|pixel| pixel.normal[0])),
        ("N.Y", real(0.0, &|pixel| pixel.normal[1])),
        ("N.Z", real(0.0, &|pixel| pixel.normal[2])),
        ("albedo.R", real(0.0, &|pixel| pixel.albedo[0])),
        ("albedo.G", real(0.0, &|pixel| pixel.albedo[1])),
        ("albedo.B", real(0.0, &|pixel| pixel.albedo[2])),
        ("triangle.low", whole(&|pixel| pixel.triangle.0 as u32)),
        ("triangle.high", whole(&|pixel| (pixel.triangle.0 >> 32) as u32)),
        ("material", whole(&|pixel| u32::from(pixel.material.0))),
    ];
    let statistics = film.statistics().unwrap_or_default();
    let of_samples = [
        ("samples", FlatSamples::U32(statistics.iter().map(|pixel| pixel.samples).collect())),
        ("deviation", FlatSamples::F32(statistics.iter().map(|pixel| pixel.deviation).collect())),
    ];
    let of_samples = of_samples.into_iter().filter(|_| !statistics.is_empty());
    let costs = film.costs().unwrap_or_default();
    let of_costs = [
        ("cost.boxes", FlatSamples::U32(costs.iter().map(|cost| cost.box_tests).collect())),
        ("cost.triangles", FlatSamples::U32(costs.iter().map(|cost| cost.triangle_tests).collect())),
    ];
    let of_costs = of_costs.into_iter().filter(|_| !costs.is_empty());
    let channels = channels
        .into_iter()
        .chain(of_samples)
        .chain(of_costs)
        .map(|(name, samples)| AnyChannel::new(name, samples));
    let size = (film.width() as usize, film.height() as usize);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels.collect()));
    // One thread: the caller did not ask for more (I8).
    Image::from_layer(layer).write().non_parallel().to_buffered(out).map_err(|error| match error {
        exr::error::Error::Io(error) => error,
        other => io::Error::other(other),
    })
}
