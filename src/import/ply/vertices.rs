//! The element `vertex`.

use super::header::{Element, Encoding, Kind, Property, Scalar};
use super::values::Values;
use crate::error::ImportError;
use crate::import::feed::Feed;

/// Reads the vertices and sends their positions on.
pub(super) fn read(
    values: &mut Values<'_, '_>,
    element: &Element,
    feed: &mut Feed<'_>,
) -> Result<(), ImportError> {
    let axes = axes(element).map_err(|reason| values.error(reason))?;
    if element.count > 1 << 32 {
        return Err(values.error(format!("{} vertices; at most 2^32 can be indexed", element.count)));
    }
    let attributes = if feed.takes_attributes() { Attributes::of(element) } else { Attributes::default() };
    feed.name_attributes_by_vertex(attributes.uv.is_some(), attributes.normal.is_some());
    note_ignored(element, &attributes, feed);
    let mut left = element.count;
    if let Some(layout) = PositionLayout::of(values.encoding(), element, axes, &attributes) {
        left -= layout.read(values, left, feed)?;
    }
    let is_text = values.encoding() == Encoding::Ascii;
    let exact_in_f32 = !is_text && axes.iter().all(|axis| axis.1.fits_f32());
    for _ in 0..left {
        let mut position = [0.0; 3];
        let (mut uv, mut normal) = ([0.0; 2], [0.0; 3]);
        let mut is_kept = feed.are_digits_kept();
        for (index, property) in element.properties.iter().enumerate() {
            match axes.iter().position(|axis| axis.0 == index) {
                Some(axis) if is_text => position[axis] = values.text_float(&mut is_kept)?,
                Some(axis) => position[axis] = values.float(axes[axis].1)?,
                None => match (attributes.place_of(index), property.kind) {
                    (Some(Place::Uv(axis)), Kind::Scalar(scalar)) => uv[axis] = values.float(scalar)? as f32,
                    (Some(Place::Normal(axis)), Kind::Scalar(scalar)) => {
                        normal[axis] = values.float(scalar)? as f32;
                    }
                    _ => values.skip_property(property.kind)?,
                },
            }
        }
        if attributes.uv.is_some() {
            feed.uv(uv)?;
        }
        if attributes.normal.is_some() {
            feed.normal(normal)?;
        }
        if exact_in_f32 {
            feed.vertex32(position.map(|value| value as f32))?;
        } else {
            feed.vertex_text(position, is_text && is_kept)?;
        }
        feed.progress(values.window.progress())?;
    }
    Ok(())
}

/// Which properties are x, y and z, and their types.
fn axes(element: &Element) -> Result<[(usize, Scalar); 3], String> {
    let mut axes = [(0, Scalar::F32); 3];
    for (axis, name) in axes.iter_mut().zip(["x", "y", "z"]) {
        let index = element.properties.iter().position(|property| property.name == name);
        let index = index.ok_or_else(|| format!("the element `vertex` has no property `{name}`"))?;
        let Kind::Scalar(scalar) = element.properties[index].kind else {
            return Err(format!("the vertex property `{name}` is a list"));
        };
        *axis = (index, scalar);
    }
    Ok(axes)
}

/// Which properties are attributes, as indices.
#[derive(Clone, Copy, Debug, Default)]
struct Attributes {
    uv: Option<[usize; 2]>,
    normal: Option<[usize; 3]>,
}

/// Where a property goes.
#[derive(Clone, Copy, Debug)]
enum Place {
    Uv(usize),
    Normal(usize),
}

impl Attributes {
    /// The first names that are all there, as numbers.
    fn of(element: &Element) -> Attributes {
        let index = |name: &str| {
            let is_it =
                |property: &Property| property.name == name && matches!(property.kind, Kind::Scalar(_));
            element.properties.iter().position(is_it)
        };
        let uv = |[u, v]: [&str; 2]| Some([index(u)?, index(v)?]);
        let normal = |[x, y, z]: [&str; 3]| Some([index(x)?, index(y)?, index(z)?]);
        let uv_names = [["u", "v"], ["s", "t"], ["texture_u", "texture_v"], ["texture_s", "texture_t"]];
        let normal_names = [["nx", "ny", "nz"], ["normal_x", "normal_y", "normal_z"]];
        Attributes {
            uv: uv_names.into_iter().find_map(uv),
            normal: normal_names.into_iter().find_map(normal),
        }
    }

    fn place_of(&self, index: usize) -> Option<Place> {
        let uv = self.uv.and_then(|uv| uv.iter().position(|at| *at == index)).map(Place::Uv);
        uv.or_else(|| self.normal?.iter().position(|at| *at == index).map(Place::Normal))
    }
}

/// Counts what the records hold besides positions, and the attributes that are taken.
fn note_ignored(element: &Element, attributes: &Attributes, feed: &mut Feed<'_>) {
    let has = |names: &[&str]| element.properties.iter().any(|p| names.contains(&p.name.as_str()));
    let ignored = &mut feed.report.ignored;
    if attributes.normal.is_none() && has(&["nx", "normal_x"]) {
        ignored.normals += element.count;
    }
    if attributes.uv.is_none() && has(&["u", "s", "texture_u", "texture_s"]) {
        ignored.texture_coordinates += element.count;
    }
    if has(&["red", "diffuse_red", "r"]) {
        ignored.vertex_colors += element.count;
    }
}

/// Where positions stand in records of one size.
#[derive(Clone, Copy, Debug)]
struct PositionLayout {
    offset: usize,
    stride: usize,
    scalar: Scalar,
    /// Where attributes stand, each number as f32.
    uv: Option<[usize; 2]>,
    normal: Option<[usize; 3]>,
}

impl PositionLayout {
    /// Binary little-endian records in which x, y and z stand together, all as f32 or all as f64; attributes, if any, as f32.
    fn of(
        encoding: Encoding,
        element: &Element,
        axes: [(usize, Scalar); 3],
        attributes: &Attributes,
    ) -> Option<PositionLayout> {
        let [x, y, z] = axes.map(|axis| axis.0);
        let scalar = axes[0].1;
        let stride = element.fixed_bytes()?;
        let fits = encoding == Encoding::LittleEndian
            && matches!(scalar, Scalar::F32 | Scalar::F64)
            && axes.iter().all(|axis| axis.1 == scalar)
            && y == x + 1
            && z == y + 1;
        let offset = |property: usize| -> usize {
            let before = element.properties[..property].iter().map(|property| match property.kind {
                Kind::Scalar(scalar) => scalar.bytes(),
                Kind::List { .. } => 0,
            });
            before.sum()
        };
        let is_single = |property: &usize| element.properties[*property].kind == Kind::Scalar(Scalar::F32);
        let are_single =
            attributes.uv.iter().flatten().chain(attributes.normal.iter().flatten()).all(is_single);
        (fits && are_single).then(|| PositionLayout {
            offset: offset(x),
            stride,
            scalar,
            uv: attributes.uv.map(|uv| uv.map(offset)),
            normal: attributes.normal.map(|normal| normal.map(offset)),
        })
    }

    /// Reads whole records in bulk as long as the stream gives them; returns how many.
    fn read(self, values: &mut Values<'_, '_>, count: u64, feed: &mut Feed<'_>) -> Result<u64, ImportError> {
        let PositionLayout { offset, stride, scalar, uv, normal } = self;
        let mut done = 0;
        while done < count {
            if values.window.data().len() < stride {
                values.window.refill()?;
                feed.progress(values.window.progress())?;
                if values.window.data().len() < stride {
                    break;
                }
            }
            let data = values.window.data();
            let left = usize::try_from(count - done).unwrap_or(usize::MAX);
            let mut take = (data.len() / stride).min(left);
            if scalar == Scalar::F64 {
                for record in data[..take * stride].chunks_exact(stride) {
                    feed.vertex64(position64(&record[offset..]))?;
                }
            } else {
                let batch = feed.singles_with_room()?;
                take = take.min(batch.capacity() - batch.len());
                let records = &data[..take * stride];
                if stride == 12 {
                    batch.extend(records.as_chunks::<12>().0.iter().map(|record| position32(record)));
                } else {
                    batch.extend(records.chunks_exact(stride).map(|record| position32(&record[offset..])));
                }
            }
            if uv.is_some() || normal.is_some() {
                for record in data[..take * stride].chunks_exact(stride) {
                    if let Some(places) = uv {
                        feed.uv(places.map(|at| single(record, at)))?;
                    }
                    if let Some(places) = normal {
                        feed.normal(places.map(|at| single(record, at)))?;
                    }
                }
            }
            values.window.consume(take * stride);
            done += take as u64;
        }
        Ok(done)
    }
}

/// The little-endian f32 at `at` of a record.
#[inline]
fn single(record: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]])
}

/// Three little-endian f32.
#[inline]
fn position32(bytes: &[u8]) -> [f32; 3] {
    let (words, _) = bytes.as_chunks::<4>();
    [words[0], words[1], words[2]].map(f32::from_le_bytes)
}

/// Three little-endian f64.
#[inline]
fn position64(bytes: &[u8]) -> [f64; 3] {
    let (words, _) = bytes.as_chunks::<8>();
    [words[0], words[1], words[2]].map(f64::from_le_bytes)
}
