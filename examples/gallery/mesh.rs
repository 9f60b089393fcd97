//! Small models in code: quads, boxes, bodies of revolution.

use std::error::Error;
use std::f64::consts::TAU;

use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, Compiler, Control};
use outcrop::import::{CornerIndices, MeshSink, NO_INDEX, VertexBatch};
use outcrop::model::MaterialRecord;
use outcrop::source::MemorySource;

/// A mesh with its materials.
#[derive(Default)]
pub struct Mesh {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<([u32; 3], usize)>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    /// Texture coordinates and normals of the corners of each triangle; those behind the last have none.
    corners: Vec<[[u32; 3]; 2]>,
    materials: Vec<MaterialRecord>,
}

impl Mesh {
    pub fn new() -> Mesh {
        Mesh::default()
    }

    /// Adds a material; later calls name it by what is returned.
    pub fn material(&mut self, name: &str, record: MaterialRecord) -> usize {
        self.materials.push(MaterialRecord { name: name.to_string(), ..record });
        self.materials.len() - 1
    }

    fn vertex(&mut self, position: [f64; 3]) -> u32 {
        self.vertices.push(position);
        self.vertices.len() as u32 - 1
    }

    /// A parallelogram whose front faces `a` x `b`.
    pub fn quad(&mut self, material: usize, corner: [f64; 3], a: [f64; 3], b: [f64; 3]) {
        let add = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|axis| p[axis] + q[axis]);
        let corners = [corner, add(corner, a), add(add(corner, a), b), add(corner, b)];
        let [p, q, r, s] = corners.map(|corner| self.vertex(corner));
        self.triangles.extend([([p, q, r], material), ([p, r, s], material)]);
    }

    /// The last `count` triangles have texture coordinates and normals by these numbers.
    fn attach(&mut self, corners: &[[[u32; 3]; 2]]) {
        self.corners.resize(self.triangles.len() - corners.len(), [[NO_INDEX; 3]; 2]);
        self.corners.extend_from_slice(corners);
    }

    /// [`Mesh::quad`] with texture coordinates from 0 to `repeats` along `a` and `b`.
    pub fn card(&mut self, material: usize, corner: [f64; 3], a: [f64; 3], b: [f64; 3], repeats: [f32; 2]) {
        let first = self.uvs.len() as u32;
        let [u, v] = repeats;
        self.uvs.extend([[0.0, 0.0], [u, 0.0], [u, v], [0.0, v]]);
        self.quad(material, corner, a, b);
        let [p, q, r, s] = [0, 1, 2, 3].map(|corner| first + corner);
        self.attach(&[[[p, q, r], [NO_INDEX; 3]], [[p, r, s], [NO_INDEX; 3]]]);
    }

    /// A ball of few facets, with texture coordinates by longitude and latitude, and with normals if it `is_smooth`.
    pub fn globe(
        &mut self,
        material: usize,
        center: [f64; 3],
        radius: f64,
        rings: u32,
        is_smooth: bool,
        repeats: [f32; 2],
    ) {
        let segments = 2 * rings;
        let (first_uv, first_normal) = (self.uvs.len() as u32, self.normals.len() as u32);
        let mut vertices = Vec::new();
        for ring in 0..=rings {
            for segment in 0..=segments {
                let (down, around) =
                    (f64::from(ring) / f64::from(rings), f64::from(segment) / f64::from(segments));
                let ((sin, cos), (x, z)) = ((0.5 * TAU * down).sin_cos(), (TAU * around).sin_cos());
                let normal = [sin * z, cos, -sin * x];
                vertices.push(self.vertex([0, 1, 2].map(|axis| center[axis] + radius * normal[axis])));
                self.normals.push(normal.map(|x| x as f32));
                self.uvs.push([around as f32 * repeats[0], (1.0 - down) as f32 * repeats[1]]);
            }
        }
        let mut corners = Vec::new();
        for ring in 0..rings {
            for segment in 0..segments {
                let at = |down: u32, around: u32| (ring + down) * (segments + 1) + segment + around;
                let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                for triangle in [[a, b, c], [a, c, d]] {
                    self.triangles.push((triangle.map(|at| vertices[at as usize]), material));
                    let normals = triangle.map(|at| if is_smooth { first_normal + at } else { NO_INDEX });
                    corners.push([triangle.map(|at| first_uv + at), normals]);
                }
            }
        }
        self.attach(&corners);
    }

    /// A closed box on the point `foot` (the middle of its lower face), turned about the vertical.
    pub fn block(&mut self, material: usize, foot: [f64; 3], size: [f64; 3], degrees: f64) {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let [w, h, d] = size;
        let (x, y, z) = ([w * cos, 0.0, -w * sin], [0.0, h, 0.0], [d * sin, 0.0, d * cos]);
        let back = |edge: [f64; 3]| edge.map(|length| -length);
        let low = [0, 1, 2].map(|axis| foot[axis] - 0.5 * (x[axis] + z[axis]));
        let high = [0, 1, 2].map(|axis| low[axis] + x[axis] + y[axis] + z[axis]);
        self.quad(material, low, y, x);
        self.quad(material, low, z, y);
        self.quad(material, low, x, z);
        self.quad(material, high, back(x), back(y));
        self.quad(material, high, back(y), back(z));
        self.quad(material, high, back(z), back(x));
    }

    /// A ground of two materials in squares around the origin at height `y`, `count` to each side.
    pub fn checkers(&mut self, materials: [usize; 2], y: f64, square: f64, count: i32) {
        for (i, j) in (-count..count).flat_map(|i| (-count..count).map(move |j| (i, j))) {
            let corner = [f64::from(i) * square, y, f64::from(j) * square];
            let material = materials[(i + j).rem_euclid(2) as usize];
            self.quad(material, corner, [0.0, 0.0, square], [square, 0.0, 0.0]);
        }
    }

    /// The body that `profile`, points (radius, height), makes when it turns about the vertical through `center`. Seen from
    /// outside the profile runs upward.
    pub fn lathe(&mut self, material: usize, center: [f64; 3], profile: &[[f64; 2]], segments: u32) {
        let rings: Vec<Vec<u32>> = profile
            .iter()
            .map(|[radius, height]| {
                let count = if *radius == 0.0 { 1 } else { segments };
                (0..count)
                    .map(|segment| {
                        let (sin, cos) = (TAU * f64::from(segment) / f64::from(segments)).sin_cos();
                        self.vertex([center[0] + radius * cos, center[1] + height, center[2] + radius * sin])
                    })
                    .collect()
            })
            .collect();
        for pair in rings.windows(2) {
            for segment in 0..segments as usize {
                let at = |ring: &[u32], segment: usize| ring[segment % ring.len()];
                let [a, b] = [0, 1].map(|next| at(&pair[0], segment + next));
                let [c, d] = [0, 1].map(|next| at(&pair[1], segment + next));
                if c != d {
                    self.triangles.push(([a, c, d], material));
                }
                if a != b {
                    self.triangles.push(([a, d, b], material));
                }
            }
        }
    }

    /// A ball, fine enough that its facets do not show.
    pub fn ball(&mut self, material: usize, center: [f64; 3], radius: f64) {
        const RINGS: u32 = 96;
        let profile: Vec<[f64; 2]> = (0..=RINGS)
            .map(|ring| {
                let (sin, cos) = (0.5 * TAU * f64::from(ring) / f64::from(RINGS)).sin_cos();
                // Exactly 0 at the poles, where all segments meet.
                [if ring % RINGS == 0 { 0.0 } else { radius * sin }, -radius * cos]
            })
            .collect();
        self.lathe(material, center, &profile, 2 * RINGS);
    }

    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// What is known of its materials.
    pub fn materials(&self) -> &[MaterialRecord] {
        &self.materials
    }

    /// The mesh as a compiled file in memory.
    pub fn compile(&self) -> Result<MemorySource, Box<dyn Error>> {
        self.compile_with(&CompileOptions::default())
    }

    /// [`Mesh::compile`] with options.
    pub fn compile_with(&self, options: &CompileOptions) -> Result<MemorySource, Box<dyn Error>> {
        let budget = MemoryBudget::new(outcrop::units::Bytes::mib(256));
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("scene.outcrop");
        let mut progress = |_| Control::Continue;
        let mut compiler = Compiler::new(&path, options.clone(), &budget, &mut progress)?;
        let mut ids = Vec::new();
        for record in &self.materials {
            ids.push(compiler.material(record.clone())?);
        }
        compiler.vertices(VertexBatch::Float64(&self.vertices))?;
        compiler.texture_coordinates(&self.uvs)?;
        compiler.normals(&self.normals)?;
        for (index, (triangle, material)) in self.triangles.iter().enumerate() {
            match self.corners.get(index) {
                None => compiler.triangles(&[*triangle], ids[*material])?,
                Some([uvs, normals]) => {
                    let corners = CornerIndices { uvs: Some(&[*uvs]), normals: Some(&[*normals]) };
                    compiler.triangles_with_attributes(&[*triangle], corners, ids[*material])?;
                }
            }
        }
        compiler.finish()?;
        let bytes = std::fs::read(&path)?;
        Ok(MemorySource::new(bytes)?)
    }
}
