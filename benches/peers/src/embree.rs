//! Embree 3 by its C API: as much of it as is used here, declared by hand from `embree3/rtcore*.h` of version 3.13.

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::ops::Range;
use std::ptr;

use crate::engine::{Engine, Found, Surface};
use crate::mesh::Mesh;
use crate::rays::{Ray32, Rays};

/// How a scene is built and traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    pub name: &'static str,
    flags: c_int,
    quality: c_int,
    packets: bool,
}

impl Mode {
    pub const DEFAULT: Mode =
        Mode { name: "Embree default", flags: 0, quality: QUALITY_MEDIUM, packets: false };
    pub const ROBUST: Mode =
        Mode { name: "Embree robust", flags: SCENE_ROBUST, quality: QUALITY_MEDIUM, packets: false };
    /// Its fastest whole job.
    pub const COMPACT_LOW: Mode =
        Mode { name: "Embree compact, low", flags: SCENE_COMPACT, quality: QUALITY_LOW, packets: false };

    /// The same scene, rays in packets of 8.
    pub fn in_packets(self, name: &'static str) -> Mode {
        Mode { name, packets: true, ..self }
    }
}

const SCENE_COMPACT: c_int = 1 << 1;
const SCENE_ROBUST: c_int = 1 << 2;
const QUALITY_LOW: c_int = 0;
const QUALITY_MEDIUM: c_int = 1;
const GEOMETRY_TRIANGLE: c_int = 0;
const BUFFER_INDEX: c_int = 0;
const BUFFER_VERTEX: c_int = 1;
const FORMAT_UINT3: c_int = 0x5003;
const FORMAT_FLOAT3: c_int = 0x9003;
const INVALID: c_uint = c_uint::MAX;

#[repr(C, align(16))]
struct RtcRay {
    origin: [f32; 3],
    t_near: f32,
    direction: [f32; 3],
    time: f32,
    t_far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
}

#[repr(C, align(16))]
struct RtcHit {
    normal: [f32; 3],
    u: f32,
    v: f32,
    primitive: c_uint,
    geometry: c_uint,
    instance: [c_uint; 1],
}

#[repr(C)]
struct RtcRayHit {
    ray: RtcRay,
    hit: RtcHit,
}

const PACKET: usize = 8;

#[repr(C, align(32))]
struct RtcRay8 {
    origin: [[f32; PACKET]; 3],
    t_near: [f32; PACKET],
    direction: [[f32; PACKET]; 3],
    time: [f32; PACKET],
    t_far: [f32; PACKET],
    mask: [c_uint; PACKET],
    id: [c_uint; PACKET],
    flags: [c_uint; PACKET],
}

#[repr(C, align(32))]
struct RtcHit8 {
    normal: [[f32; PACKET]; 3],
    u: [f32; PACKET],
    v: [f32; PACKET],
    primitive: [c_uint; PACKET],
    geometry: [c_uint; PACKET],
    instance: [[c_uint; PACKET]; 1],
}

#[repr(C)]
struct RtcRayHit8 {
    ray: RtcRay8,
    hit: RtcHit8,
}

#[repr(C, align(32))]
struct Valid8([c_int; PACKET]);

#[repr(C)]
struct RtcIntersectContext {
    flags: c_int,
    filter: *const c_void,
    instance: [c_uint; 1],
    min_width_distance_factor: f32,
}

type Handle = *mut c_void;

// SAFETY: declared as in the headers of Embree 3.13; enums are ints there.
unsafe extern "C" {
    fn rtcNewDevice(config: *const c_char) -> Handle;
    fn rtcReleaseDevice(device: Handle);
    fn rtcGetDeviceError(device: Handle) -> c_int;
    fn rtcGetDeviceProperty(device: Handle, property: c_int) -> isize;
    fn rtcNewScene(device: Handle) -> Handle;
    fn rtcReleaseScene(scene: Handle);
    fn rtcSetSceneFlags(scene: Handle, flags: c_int);
    fn rtcSetSceneBuildQuality(scene: Handle, quality: c_int);
    fn rtcCommitScene(scene: Handle);
    fn rtcNewGeometry(device: Handle, kind: c_int) -> Handle;
    fn rtcReleaseGeometry(geometry: Handle);
    fn rtcSetGeometryBuildQuality(geometry: Handle, quality: c_int);
    fn rtcSetSharedGeometryBuffer(
        geometry: Handle,
        kind: c_int,
        slot: c_uint,
        format: c_int,
        start: *const c_void,
        byte_offset: usize,
        byte_stride: usize,
        count: usize,
    );
    fn rtcCommitGeometry(geometry: Handle);
    fn rtcAttachGeometry(scene: Handle, geometry: Handle) -> c_uint;
    fn rtcIntersect1(scene: Handle, context: *mut RtcIntersectContext, ray_hit: *mut RtcRayHit);
    fn rtcIntersect8(
        valid: *const c_int,
        scene: Handle,
        context: *mut RtcIntersectContext,
        ray_hit: *mut RtcRayHit8,
    );
    fn rtcOccluded1(scene: Handle, context: *mut RtcIntersectContext, ray: *mut RtcRay);
    fn rtcOccluded8(valid: *const c_int, scene: Handle, context: *mut RtcIntersectContext, ray: *mut RtcRay8);
}

/// A scene over a mesh that it shares.
pub struct Embree<'m> {
    mode: Mode,
    device: Handle,
    scene: Handle,
    mesh: std::marker::PhantomData<&'m Mesh>,
}

impl<'m> Embree<'m> {
    /// Builds on this thread alone. Embree reads whole vectors, so the mesh must have a spare vertex at the end: see
    /// [`Embree::pad`].
    pub fn new(mesh: &'m Mesh, mode: Mode) -> Result<Embree<'m>, String> {
        const CONFIG: &CStr = c"threads=1,user_threads=1,set_affinity=0";
        assert!(mesh.vertices.capacity() > mesh.vertices.len(), "the mesh is not padded");
        // SAFETY: the calls are in the order that the API asks for, with handles that it gave. The mesh outlives the
        // scene by its lifetime, and is padded.
        unsafe {
            let device = rtcNewDevice(CONFIG.as_ptr());
            if device.is_null() {
                return Err("Embree does not start on this machine".to_string());
            }
            let geometry = rtcNewGeometry(device, GEOMETRY_TRIANGLE);
            let buffer = |kind, format, start, count| {
                rtcSetSharedGeometryBuffer(geometry, kind, 0, format, start, 0, 12, count);
            };
            buffer(BUFFER_VERTEX, FORMAT_FLOAT3, mesh.vertices.as_ptr().cast(), mesh.vertices.len());
            buffer(BUFFER_INDEX, FORMAT_UINT3, mesh.triangles.as_ptr().cast(), mesh.triangles.len());
            rtcSetGeometryBuildQuality(geometry, mode.quality);
            rtcCommitGeometry(geometry);
            let scene = rtcNewScene(device);
            rtcSetSceneFlags(scene, mode.flags);
            rtcSetSceneBuildQuality(scene, mode.quality);
            rtcAttachGeometry(scene, geometry);
            rtcReleaseGeometry(geometry);
            rtcCommitScene(scene);
            let embree = Embree { mode, device, scene, mesh: std::marker::PhantomData };
            match rtcGetDeviceError(device) {
                0 => Ok(embree),
                error => Err(format!("Embree fails to build the scene: error {error}")),
            }
        }
    }

    /// Makes room behind the last vertex, which Embree may read but does not use.
    pub fn pad(mesh: &mut Mesh) {
        mesh.vertices.reserve_exact(2);
    }

    /// "3.13.5"
    pub fn version() -> Option<String> {
        // SAFETY: a device of its own, released at once. The properties 1, 2 and 3 are the parts of the version.
        let parts: [isize; 3] = unsafe {
            let device = rtcNewDevice(ptr::null());
            if device.is_null() {
                return None;
            }
            let parts = [1, 2, 3].map(|property| rtcGetDeviceProperty(device, property));
            rtcReleaseDevice(device);
            parts
        };
        Some(parts.map(|part| part.to_string()).join("."))
    }
}

impl Embree<'_> {
    fn intersect(&self, from: &Ray32, context: &mut RtcIntersectContext) -> RtcRayHit {
        let hit = RtcHit {
            normal: [0.0; 3],
            u: 0.0,
            v: 0.0,
            primitive: INVALID,
            geometry: INVALID,
            instance: [INVALID],
        };
        let mut ray_hit = RtcRayHit { ray: ray(from), hit };
        // SAFETY: a committed scene, and structures laid out as the header has them.
        unsafe { rtcIntersect1(self.scene, context, &mut ray_hit) };
        ray_hit
    }
}

impl Drop for Embree<'_> {
    fn drop(&mut self) {
        // SAFETY: both were made in `new` and are released once.
        unsafe {
            rtcReleaseScene(self.scene);
            rtcReleaseDevice(self.device);
        }
    }
}

fn context() -> RtcIntersectContext {
    RtcIntersectContext { flags: 0, filter: ptr::null(), instance: [INVALID], min_width_distance_factor: 0.0 }
}

fn ray(from: &Ray32) -> RtcRay {
    RtcRay {
        origin: from.origin,
        t_near: 0.0,
        direction: from.direction,
        time: 0.0,
        t_far: from.t_max,
        mask: u32::MAX,
        id: 0,
        flags: 0,
    }
}

fn found(geometry: c_uint, primitive: c_uint, t: f32) -> Found {
    if geometry == INVALID { Found::NONE } else { Found { t: f64::from(t), triangle: primitive } }
}

/// Up to eight rays; the mask says which lanes hold one.
fn packet(rays: &[Ray32]) -> (Valid8, RtcRay8) {
    let mut valid = Valid8([0; PACKET]);
    let mut packet = RtcRay8 {
        origin: [[0.0; PACKET]; 3],
        t_near: [0.0; PACKET],
        direction: [[1.0; PACKET]; 3],
        time: [0.0; PACKET],
        t_far: [0.0; PACKET],
        mask: [u32::MAX; PACKET],
        id: [0; PACKET],
        flags: [0; PACKET],
    };
    for (lane, ray) in rays.iter().enumerate() {
        valid.0[lane] = -1;
        for axis in 0..3 {
            packet.origin[axis][lane] = ray.origin[axis];
            packet.direction[axis][lane] = ray.direction[axis];
        }
        packet.t_far[lane] = ray.t_max;
    }
    (valid, packet)
}

/// Denormals as zero while this lives, as Embree's manual recommends for speed; the caller's mode again afterwards.
struct FlushDenormals {
    #[cfg(target_arch = "x86_64")]
    before: u32,
}

impl FlushDenormals {
    #[cfg(target_arch = "x86_64")]
    fn new() -> FlushDenormals {
        const FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO: u32 = 0x8040;
        let mut before = 0_u32;
        // SAFETY: reads MXCSR to memory, and writes it back with two mode bits set. Only Embree computes floats until
        // the mode is restored.
        unsafe {
            std::arch::asm!("stmxcsr [{}]", in(reg) &mut before, options(nostack));
            let now = before | FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO;
            std::arch::asm!("ldmxcsr [{}]", in(reg) &now, options(nostack));
        }
        FlushDenormals { before }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn new() -> FlushDenormals {
        FlushDenormals {}
    }
}

#[cfg(target_arch = "x86_64")]
impl Drop for FlushDenormals {
    fn drop(&mut self) {
        // SAFETY: writes back what `new` read.
        unsafe { std::arch::asm!("ldmxcsr [{}]", in(reg) &self.before, options(nostack)) };
    }
}

impl Engine for Embree<'_> {
    fn name(&self) -> &str {
        self.mode.name
    }

    fn closest(&mut self, rays: &Rays, range: Range<usize>, found_here: &mut [Found]) {
        let _mode = FlushDenormals::new();
        let mut context = context();
        let rays = &rays.single[range];
        if !self.mode.packets {
            for (from, to) in rays.iter().zip(found_here) {
                let ray_hit = self.intersect(from, &mut context);
                *to = found(ray_hit.hit.geometry, ray_hit.hit.primitive, ray_hit.ray.t_far);
            }
            return;
        }
        for (from, to) in rays.chunks(PACKET).zip(found_here.chunks_mut(PACKET)) {
            let (valid, ray) = packet(from);
            let hit = RtcHit8 {
                normal: [[0.0; PACKET]; 3],
                u: [0.0; PACKET],
                v: [0.0; PACKET],
                primitive: [INVALID; PACKET],
                geometry: [INVALID; PACKET],
                instance: [[INVALID; PACKET]],
            };
            let mut ray_hit = RtcRayHit8 { ray, hit };
            // SAFETY: as above.
            unsafe { rtcIntersect8(valid.0.as_ptr(), self.scene, &mut context, &mut ray_hit) };
            for (lane, to) in to.iter_mut().enumerate() {
                let RtcRayHit8 { ray, hit } = &ray_hit;
                *to = found(hit.geometry[lane], hit.primitive[lane], ray.t_far[lane]);
            }
        }
    }

    fn occluded(&mut self, rays: &Rays, range: Range<usize>, blocked: &mut [bool]) {
        let _mode = FlushDenormals::new();
        let mut context = context();
        let rays = &rays.single[range];
        if !self.mode.packets {
            for (from, to) in rays.iter().zip(blocked) {
                let mut ray = ray(from);
                // SAFETY: as above.
                unsafe { rtcOccluded1(self.scene, &mut context, &mut ray) };
                // Embree says so by t_far = -inf.
                *to = ray.t_far < 0.0;
            }
            return;
        }
        for (from, to) in rays.chunks(PACKET).zip(blocked.chunks_mut(PACKET)) {
            let (valid, mut ray) = packet(from);
            // SAFETY: as above.
            unsafe { rtcOccluded8(valid.0.as_ptr(), self.scene, &mut context, &mut ray) };
            for (lane, to) in to.iter_mut().enumerate() {
                *to = ray.t_far[lane] < 0.0;
            }
        }
    }

    fn surfaces(&mut self, rays: &Rays, range: Range<usize>, surfaces: &mut [Option<Surface>]) {
        let _mode = FlushDenormals::new();
        let mut context = context();
        for (from, to) in rays.single[range].iter().zip(surfaces) {
            let RtcRayHit { ray, hit } = self.intersect(from, &mut context);
            *to = (hit.geometry != INVALID)
                .then(|| Surface { t: f64::from(ray.t_far), normal: hit.normal.map(f64::from) });
        }
    }
}
