//! Eight rays prepared together, each then read by itself.

use super::boxes::{BOX_RAY_WORDS, BoxRay, box_ray_words};
use super::lanes::{LANES, Simd};
use super::triangles::TriangleRay;

/// A ray ready for the tests of both kinds: 24 words.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct TestRay {
    /// For boxes.
    pub boxes: BoxRay,
    /// For triangles.
    pub triangles: TriangleRay,
}

impl TestRay {
    /// No ray yet.
    pub const UNSET: TestRay =
        TestRay { boxes: BoxRay::UNSET, triangles: TriangleRay { origin: [0.0; 3], direction: [0.0; 3] } };
}

const ROWS: usize = 3;

/// Eight [`TestRay`]s: computed word by word for all, and turned so that the words of each lie together.
#[derive(Clone, Copy, Debug)]
pub struct RayRows {
    rays: [[[f32; LANES]; ROWS]; LANES],
}

const _: () = assert!(size_of::<TestRay>() == ROWS * LANES * 4 && align_of::<TestRay>() == align_of::<f32>());
const _: () = assert!(BOX_RAY_WORDS == 18);

impl RayRows {
    /// Lane `i` is ray `i`: directions that are oblique ([`BoxRay::is_oblique`]), largest magnitude 1 to 2, and origins, both
    /// rounded.
    #[inline(always)]
    pub fn new<S: Simd>(simd: S, direction: &[S::F; 3], origin: &[S::F; 3]) -> RayRows {
        let [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r] = box_ray_words(simd, direction, origin);
        let rows = [
            simd.transpose(&[a, b, c, d, e, f, g, h]),
            simd.transpose(&[i, j, k, l, m, n, o, p]),
            simd.transpose(&[
                q,
                r,
                origin[0],
                origin[1],
                origin[2],
                direction[0],
                direction[1],
                direction[2],
            ]),
        ];
        let mut rays = [[[0.0; LANES]; ROWS]; LANES];
        for (lane, ray) in rays.iter_mut().enumerate() {
            ray[0] = simd.to_array(rows[0][lane]);
            ray[1] = simd.to_array(rows[1][lane]);
            ray[2] = simd.to_array(rows[2][lane]);
        }
        RayRows { rays }
    }

    /// Ray `lane`.
    ///
    /// # Panics
    /// If `lane` is not below 8.
    #[inline(always)]
    pub fn get(&self, lane: usize) -> &TestRay {
        let ray: *const [[f32; LANES]; ROWS] = &self.rays[lane];
        // SAFETY: same size, alignment no stricter, and any bits are an f32 or a u32. The words were put there by `new` in the
        // order of the fields of `BoxRay` and `TriangleRay`, which are `repr(C)`: so the rows of `Axis` hold what they must.
        unsafe { &*ray.cast::<TestRay>() }
    }
}
