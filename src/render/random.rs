//! Random numbers of effects: a pure function of (seed, pixel, sample, path vertex, dimension), so that neither tiles nor
//! threads nor what else was drawn can show (I2).
//!
//! Each (pixel, vertex, dimension) has its own two-dimensional sequence over the samples of the pixel: Sobol's first two
//! dimensions, shuffled and scrambled after Owen by hashing (B. Burley, "Practical Hash-based Owen Scrambling", JCGT 2020,
//! "padding"). So every pair of numbers is as well stratified over the samples as the positions in the pixel are, for any
//! sample count and any depth, and pairs of different dimensions are independent. Higher Sobol dimensions, the alternative,
//! need tables, end at some depth, and their two-dimensional projections are worse.

use super::sampling::{mix, owen_scramble, sobol_second};

/// What a random number decides at a path vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dimension {
    /// The point of the lens.
    Lens,
    /// The time between opening and closing of the shutter.
    Shutter,
    /// The direction of a diffuse bounce.
    Bounce,
    /// The microfacet of a rough surface.
    Microfacet,
    /// Which of several rays goes on.
    Choice,
    /// Whether a faint ray of this index goes on.
    Roulette(u32),
    /// The direction to the environment, and whether its faint light is asked for.
    Environment,
    EnvironmentRoulette,
    /// The point of the light with this index, and whether its faint light is asked for.
    Light(u32),
    LightRoulette(u32),
    /// The same for lights without extent.
    PointLightRoulette(u32),
}

impl Dimension {
    fn code(self) -> u64 {
        // Two bits say which family; an index is below 2^32.
        match self {
            Dimension::Lens => 0,
            Dimension::Shutter => 1,
            Dimension::Bounce => 2,
            Dimension::Microfacet => 3,
            Dimension::Choice => 4,
            Dimension::Environment => 5,
            Dimension::EnvironmentRoulette => 6,
            Dimension::Roulette(index) => 8 + u64::from(index & 7),
            Dimension::Light(index) => 1 << 32 | u64::from(index),
            Dimension::LightRoulette(index) => 2 << 32 | u64::from(index),
            Dimension::PointLightRoulette(index) => 3 << 32 | u64::from(index),
        }
    }
}

/// Names a vertex in the ray tree of a sample: a hash of the kinds of rays that led there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct VertexId(u32);

impl VertexId {
    /// The camera.
    pub const CAMERA: VertexId = VertexId(0);

    /// Where the ray of this kind arrives that leaves this vertex.
    pub fn child(self, kind: u32) -> VertexId {
        VertexId(mix(u64::from(self.0) << 32 | u64::from(kind + 1)) as u32)
    }
}

/// The key of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SampleKey {
    /// Seed and pixel.
    pixel: u64,
    sample: u32,
}

impl SampleKey {
    pub fn new(seed: u64, pixel: u64, sample: u32) -> SampleKey {
        let seed = mix(seed ^ 0x5851_f42d_4c95_7f2d);
        SampleKey { pixel: mix(seed ^ pixel.wrapping_mul(0xd134_2543_de82_ef95)), sample }
    }

    /// Two numbers in 0 .. 1.
    pub fn pair(&self, vertex: VertexId, dimension: Dimension) -> [f64; 2] {
        let base = mix(self.pixel ^ mix(u64::from(vertex.0) << 34 ^ dimension.code()));
        // Shuffling keeps the first 2^k samples an elementary interval of the sequence.
        let index = owen_scramble(self.sample, base as u32);
        let seeds = mix(base ^ 0x9e37_79b9_7f4a_7c15);
        let fraction = |bits: u32| f64::from(bits) * (1.0 / 4_294_967_296.0);
        [
            fraction(owen_scramble(index.reverse_bits(), (base >> 32) as u32)),
            fraction(owen_scramble(sobol_second(index), seeds as u32)),
        ]
    }

    /// One number in 0 .. 1.
    pub fn one(&self, vertex: VertexId, dimension: Dimension) -> f64 {
        self.pair(vertex, dimension)[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_dimension_of_every_vertex_is_stratified_over_the_samples() {
        let vertex = VertexId::CAMERA.child(2).child(1);
        for (pixel, vertex, dimension) in [
            (0, VertexId::CAMERA, Dimension::Lens),
            (7, vertex, Dimension::Bounce),
            (123_456, vertex, Dimension::Light(3)),
        ] {
            for (columns, rows) in [(16, 1), (4, 4), (1, 16), (8, 2)] {
                let mut seen = [0u32; 16];
                for sample in 0..16 {
                    let [x, y] = SampleKey::new(9, pixel, sample).pair(vertex, dimension);
                    assert!((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y));
                    seen[(x * f64::from(columns)) as usize * rows as usize
                        + (y * f64::from(rows)) as usize] += 1;
                }
                assert_eq!(seen, [1; 16], "{pixel} {dimension:?} in {columns} x {rows}");
            }
        }
    }

    #[test]
    fn different_keys_give_independent_numbers() {
        let (a, b) = (VertexId::CAMERA.child(0), VertexId::CAMERA.child(1));
        assert_ne!(a.child(1), b.child(0));
        let draws = |vertex, dimension| {
            (0..4096u64).map(move |pixel| SampleKey::new(1, pixel, 0).one(vertex, dimension))
        };
        let base: Vec<f64> = draws(a, Dimension::Bounce).collect();
        for (vertex, dimension) in [
            (b, Dimension::Bounce),
            (a, Dimension::Microfacet),
            (a, Dimension::Light(0)),
            (a, Dimension::LightRoulette(0)),
            (a, Dimension::Roulette(1)),
        ] {
            let product: f64 =
                draws(vertex, dimension).zip(&base).map(|(x, y)| (x - 0.5) * (y - 0.5)).sum::<f64>() / 4096.0;
            // The standard deviation of the mean is 1 / 12 / 64.
            assert!(product.abs() < 5.0 / 768.0, "{dimension:?}: {product}");
        }
        let mean = base.iter().sum::<f64>() / 4096.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
    }
}
