//! Every way in which the library can fail, with what, where and what to do. Those of the roles of a cluster stand with them, in
//! [`cluster`](crate::cluster).
//!
//! What the system said stands in the message and is the error's [`source()`](std::error::Error::source) too.
//!
//! One enum per room, so that a caller can match on what it can handle (with an arm for the rest: variants may be added); [`Error`]
//! joins the usual ones for callers that only report.

use std::io;
use std::path::PathBuf;

use crate::units::{BlockId, Bytes};

/// The memory budget is too small for what was asked.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the memory budget of {limit} cannot hold {purpose}: {needed} needed, {available} left; raise the budget"
)]
pub struct BudgetError {
    /// The part that asked.
    pub purpose: &'static str,
    /// What it asked for.
    pub needed: Bytes,
    /// What was left.
    pub available: Bytes,
    /// The whole budget.
    pub limit: Bytes,
}

/// A block's bytes are not what they should be (I5). Offsets are from the start of the block.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("block {} is damaged at byte {offset}: {reason}; compile the model again or restore the file", block.0)]
pub struct BlockError {
    /// Which block.
    pub block: BlockId,
    /// Where in the block's stored bytes.
    pub offset: u64,
    /// What is wrong there.
    pub reason: &'static str,
}

/// The bytes of a page of attributes are not what they should be (I5). Offsets are from the start of the page.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "page {page} of the attributes is damaged at byte {offset}: {reason}; compile the model again or restore the file"
)]
pub struct AttributeError {
    /// Which page.
    pub page: u32,
    /// Where in its stored bytes.
    pub offset: u64,
    /// What is wrong there.
    pub reason: &'static str,
}

/// A block could not be encoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The input is not a valid block, or the codec refused it.
    #[error("a block cannot be encoded: {0}")]
    Invalid(&'static str),
    /// The input is larger than the block size of the file. Cut it into smaller blocks.
    #[error(
        "a block of {triangle_count} triangles and {vertex_count} {} is larger than the block size of {limit} bytes",
        if *wide { "wide vertices" } else { "vertices" }
    )]
    TooLarge {
        /// Vertices in the input.
        vertex_count: usize,
        /// Triangles in the input.
        triangle_count: usize,
        /// Whether its vertices take 24 bytes each instead of 12.
        wide: bool,
        /// The block size.
        limit: u32,
    },
    /// The codec is not in this build.
    #[error(
        "this build of outcrop lacks the block codec {codec}; build it with the feature `{codec}` or choose another codec"
    )]
    CodecMissing {
        /// Its name.
        codec: &'static str,
    },
}

impl From<EncodeError> for CompileError {
    fn from(error: EncodeError) -> CompileError {
        CompileError::Limit { reason: error.to_string() }
    }
}

/// A compiled file's header, directory or material table is not what it should be.
/// Offsets are from the start of the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// Not a compiled file at all.
    #[error(
        "not a compiled outcrop file (it does not start with the outcrop signature); compile the model first"
    )]
    NotCompiled,
    /// A version that this library does not read.
    #[error(
        "format version {found} is not supported (this library reads version {supported}); compile the model again"
    )]
    Version {
        /// In the file.
        found: u32,
        /// By this library.
        supported: u32,
    },
    /// The file uses a feature of the format that this build does not have.
    #[error("the file needs {feature}, which this build of outcrop does not have")]
    Feature {
        /// Which feature.
        feature: &'static str,
    },
    /// Bytes that cannot be right.
    #[error("the {part} is damaged at byte {offset}: {reason}; compile the model again or restore the file")]
    Damaged {
        /// Header, directory or materials.
        part: &'static str,
        /// Where in the file.
        offset: u64,
        /// What is wrong there.
        reason: &'static str,
    },
    /// A part is larger than the format or the machine can hold. Only when a file is written.
    #[error("{reason}")]
    Limit {
        /// Which limit.
        reason: &'static str,
    },
}

impl From<ModelError> for CompileError {
    fn from(error: ModelError) -> CompileError {
        CompileError::Limit { reason: error.to_string() }
    }
}

/// A block or a compiled file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The operating system (or a remote end) failed.
    #[error("cannot read {what} of {name}: {error}")]
    Io {
        /// "the header", "block 17" and the like.
        what: String,
        /// The file or other origin.
        name: String,
        /// The cause.
        #[source]
        error: io::Error,
    },
    /// The file ends before the bytes that were asked for.
    #[error(
        "{name} ends at byte {end} inside {what}; it was truncated after it was compiled: compile the model again"
    )]
    Truncated {
        /// "the header", "block 17" and the like.
        what: String,
        /// The file or other origin.
        name: String,
        /// Where it ends.
        end: u64,
    },
    /// No block has that number.
    #[error("{name} has no block {}: it holds {count}", block.0)]
    NoSuchBlock {
        /// The number asked for.
        block: BlockId,
        /// The file or other origin.
        name: String,
        /// How many there are.
        count: u32,
    },
    /// The source has no such page of attributes, or none at all.
    #[error(
        "{name} cannot give page {page} of the attributes; render from the compiled file itself, or switch the effects off that need them"
    )]
    NoAttributes {
        /// The page asked for.
        page: u32,
        /// The file or other origin.
        name: String,
    },
    /// The budget has no room for what is known of the model: its directory and materials.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// The file is not a valid compiled file.
    #[error("{name}: {error}")]
    Model {
        /// The file or other origin.
        name: String,
        /// The cause.
        #[source]
        error: ModelError,
    },
}

/// A model file could not be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The operating system failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The model file or a file that it names.
        path: PathBuf,
        /// The cause.
        #[source]
        error: io::Error,
    },
    /// A text file has a line that means nothing.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The model file or a file that it names.
        path: PathBuf,
        /// Counted from 1.
        line: u64,
        /// What is wrong there.
        reason: String,
    },
    /// A binary file has bytes that mean nothing.
    #[error("{} at byte {offset}: {reason}", path.display())]
    Byte {
        /// The model file.
        path: PathBuf,
        /// Counted from 0, after decompression for `.gz`.
        offset: u64,
        /// What is wrong there.
        reason: String,
    },
    /// A document has a part that means nothing, or that is not supported.
    #[error("{}: {element}: {reason}", path.display())]
    Element {
        /// The model file.
        path: PathBuf,
        /// The part, as a path in the document: `meshes[3].primitives[0]`.
        element: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The file's kind is not known.
    #[error(
        "{}: unknown kind of model file; known are .obj, .ply and .stl, each also as .gz, and .gltf and .glb (feature `gltf`)",
        path.display()
    )]
    UnknownKind {
        /// The model file.
        path: PathBuf,
    },
    /// The receiver of the geometry failed.
    #[error(transparent)]
    Sink(Box<CompileError>),
}

/// A compile could not be finished. No file that opens is left behind.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompileError {
    /// The source could not be imported.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// Writing the compiled file or the spill beside it failed.
    #[error("cannot write {}: {error}; free some space or choose another place for the output", path.display())]
    Write {
        /// The file that was being written.
        path: PathBuf,
        /// The cause (`StorageFull` for a full disk).
        #[source]
        error: io::Error,
    },
    /// The budget is too small.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// A coordinate is NaN or infinite.
    #[error(
        "triangle {triangle} has a coordinate that is not finite; correct the model, or skip and count such triangles with `CompileOptions::skip_not_finite`"
    )]
    NotFinite {
        /// Ordinal of the triangle in the source.
        triangle: u64,
    },
    /// The model has no triangles.
    #[error("the model has no triangles")]
    Empty,
    /// The geometry does not fit the chosen precision or the format's limits.
    #[error("{reason}")]
    Limit {
        /// Which limit, and what to do.
        reason: String,
    },
    /// The caller's callback asked to stop.
    #[error("the compile was cancelled")]
    Cancelled,
    /// Another process, or another part of this one, has the working file of a lazy compile open.
    #[error(
        "{} is in use by another lazy compile of the same model; wait for it to end or choose another output",
        path.display()
    )]
    Locked {
        /// The working file.
        path: PathBuf,
    },
    /// The working file of a lazy compile has bytes that cannot be right, or cannot be read.
    #[error("{} is damaged at byte {offset}: {reason}; remove it to start anew", path.display())]
    WorkingFile {
        /// The working file.
        path: PathBuf,
        /// Where in it.
        offset: u64,
        /// What is wrong there.
        reason: String,
    },
}

/// The pictures of a model could not be read or converted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TextureError {
    /// The operating system failed.
    #[error("cannot read or write {}: {error}", path.display())]
    Io {
        /// The image, or the file of tiles.
        path: PathBuf,
        /// The cause.
        #[source]
        error: io::Error,
    },
    /// An image that cannot be used.
    #[error("the image {} {reason}", path.display())]
    Image {
        /// The image.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// The file of tiles has bytes that cannot be right.
    #[error("{} is damaged at byte {offset}: {reason}; remove it to have it made again", path.display())]
    Damaged {
        /// The file of tiles.
        path: PathBuf,
        /// Where in it.
        offset: u64,
        /// What is wrong there.
        reason: &'static str,
    },
    /// The budget is too small.
    #[error(transparent)]
    Budget(#[from] BudgetError),
}

/// A missing block could not be brought in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// Its bytes could not be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// Its bytes are damaged.
    #[error(transparent)]
    Block(#[from] BlockError),
    /// A tile of a picture could not be brought in.
    #[error(transparent)]
    Texture(Box<TextureError>),
    /// The bytes of attributes are damaged.
    #[error(transparent)]
    Attributes(#[from] AttributeError),
    /// A cell of a model that is compiled lazily could not be cut into blocks.
    #[error(transparent)]
    Cut(Box<CompileError>),
    /// The budget has no room for what is known of a cell that was cut.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// The cache has no slot to give: every slot is pinned.
    #[error("all {slots} cache slots are pinned; raise the memory budget or lower the thread count")]
    NoSlot {
        /// How many there are.
        slots: u32,
    },
}

/// A trace of block accesses could not be written or read. Offsets are from the start of the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AccessTraceError {
    /// The operating system failed.
    #[error("cannot read or write the access trace: {0}")]
    Io(#[source] io::Error),
    /// The model has more blocks than a trace can be of.
    #[error(
        "a trace of {block_count} blocks cannot be recorded: {limit} are the most; compile with larger blocks"
    )]
    TooManyBlocks {
        /// In the model.
        block_count: u32,
        /// For a trace.
        limit: u32,
    },
    /// Not a trace at all.
    #[error("not an access trace (it does not start with its signature); record one first")]
    NotATrace,
    /// A version that this library does not read.
    #[error(
        "access trace version {found} is not supported (this library reads version {supported}); record it again"
    )]
    Version {
        /// In the file.
        found: u32,
        /// By this library.
        supported: u32,
    },
    /// Bytes that cannot be right.
    #[error("the access trace is damaged at byte {offset}: {reason}; record it again")]
    Damaged {
        /// Where in the file.
        offset: u64,
        /// What is wrong there.
        reason: &'static str,
    },
}

/// A query or an octree could not be set up or answered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TraceError {
    /// A block that a ray reached could not be brought in. The results of the call are not to be used.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The budget is too small.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// An octree gives no more tracers: as many live as it was opened for.
    #[error(
        "{wanted} tracers are wanted and the octree was opened for {tracers_max}: open it with `OctreeOptions::tracers_max` at least {wanted}, or use fewer threads (a render takes one tracer for each)"
    )]
    TooManyTracers {
        /// How many would live at once.
        wanted: u32,
        /// How many the octree was opened for.
        tracers_max: u32,
    },
    /// The slots of a cache that the caller made are too small for the trees of this model's blocks.
    #[error(
        "the slots of the given cache have {slot_bytes} and a block's tree takes {needed}: make it with `LazyOctree::slot_bytes`, or compile with smaller blocks"
    )]
    SlotsTooSmall {
        /// What a slot has.
        slot_bytes: Bytes,
        /// What the largest tree takes.
        needed: Bytes,
    },
    /// The cache has, or may have, fewer slots than there may be tracers, so one could be left without any.
    #[error(
        "the cache may have {slot_count} slots and needs {needed}, one for each tracer: raise `OctreeOptions::slots_max` or make the given cache larger, or lower `OctreeOptions::tracers_max`"
    )]
    TooFewSlots {
        /// How many it has.
        slot_count: u32,
        /// How many it needs.
        needed: u32,
    },
    /// A ray has a component that is not finite, a zero direction, or `t_min` outside `0 ..= t_max`.
    #[error("ray {index} is not valid: {reason}")]
    InvalidRay {
        /// Index in the slice that was passed.
        index: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
}

/// Instances could not be placed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// A model could not be opened.
    #[error("model {model}: {error}")]
    Model {
        /// Its number.
        model: usize,
        /// The cause.
        #[source]
        error: TraceError,
    },
    /// The budget has no room for what is known of the instances.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// An instance that cannot be.
    #[error("instance {instance}: {reason}")]
    Instance {
        /// Its number.
        instance: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// More than can be numbered.
    #[error("{count} {what}; there can be {most} at most")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many there are.
        count: u64,
        /// How many there could be.
        most: u64,
    },
}

/// A picture could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A query failed.
    #[error(transparent)]
    Trace(#[from] TraceError),
    /// The budget is too small.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// A setting that makes no sense.
    #[error("{what}: {reason}")]
    Setting {
        /// Which setting.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// An image or a scene file could not be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause, and what to do.
        reason: String,
    },
    /// The image file could not be written.
    #[error("cannot write {}: {error}", path.display())]
    Write {
        /// The image file.
        path: PathBuf,
        /// The cause.
        #[source]
        error: io::Error,
    },
    /// The caller asked to stop.
    #[error("the render was cancelled")]
    Cancelled,
}

/// A scene file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneFileError {
    /// The operating system failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The scene file.
        path: PathBuf,
        /// The cause.
        #[source]
        error: io::Error,
    },
    /// It is no text, or longer than any scene file.
    #[error("{}: {reason}", path.display())]
    Text {
        /// The scene file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// A part of it is not TOML, is not known, or makes no sense.
    #[error("{}:{line}: {}{reason}", path.display(), named(key))]
    Key {
        /// The scene file.
        path: PathBuf,
        /// Counted from 1: where the key's value or its table begins.
        line: u64,
        /// The key with its tables, as in `light.spot[2].radius`; empty if the text is no TOML.
        key: String,
        /// What is wrong, and what to do.
        reason: String,
    },
}

/// A key before what is wrong with it.
fn named(key: &str) -> String {
    if key.is_empty() { String::new() } else { format!("`{key}`: ") }
}

/// A frame could not be sent or received, or a connection not be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// Nobody answers at an address, or the address cannot be used.
    #[error("cannot connect to {address}: {reason}")]
    Connect {
        /// Where to.
        address: String,
        /// Why not.
        reason: String,
    },
    /// This node cannot listen at an address.
    #[error("cannot listen at {address}: {reason}")]
    Listen {
        /// Where.
        address: String,
        /// Why not.
        reason: String,
    },
    /// The node at an address does not take this one, or is not what it should be.
    #[error("{address} and this node cannot work together: {reason}")]
    Refused {
        /// Where.
        address: String,
        /// Why.
        reason: String,
    },
    /// The key that nodes share cannot be read. The message does not hold the key.
    #[error("{name}: {reason}")]
    Key {
        /// The file or variable.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A frame is longer than the transport carries.
    #[error("a frame of {bytes} bytes is longer than the transport carries ({limit})")]
    FrameTooLong {
        /// Its length.
        bytes: usize,
        /// The longest.
        limit: usize,
    },
    /// There is no such connection any more.
    #[error("connection {peer} has ended")]
    NotConnected {
        /// Its number.
        peer: u64,
    },
    /// The peer does not take what is sent to it.
    #[error("connection {peer} is not taking what was sent before")]
    QueueFull {
        /// Its number.
        peer: u64,
    },
    /// MPI cannot be used.
    #[error("MPI cannot be used: {reason}")]
    Mpi {
        /// Why not.
        reason: String,
    },
    /// The transport was closed.
    #[error("the transport is closed")]
    Closed,
}

/// A scheduler could not be made, or was told something that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ScheduleError {
    /// An option that makes no sense.
    #[error("{what}: {reason}")]
    Option {
        /// Which option.
        what: &'static str,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Cells that the image does not have. Whoever sent them renders another image.
    #[error("tile {tile} has no cells {cells:#018x}: the image has {tile_count} tiles")]
    NoSuchCells {
        /// The tile that was named.
        tile: u32,
        /// The set of cells that was named.
        cells: u64,
        /// How many tiles there are.
        tile_count: u32,
    },
    /// A worker that did not join, or left.
    #[error("worker {worker} is not part of this render; it has to join first")]
    UnknownWorker {
        /// The worker's number.
        worker: u64,
    },
    /// A checkpoint that cannot be read, or that belongs to another image.
    #[error("the scheduler's checkpoint is not usable at byte {offset}: {reason}")]
    Checkpoint {
        /// Where.
        offset: u64,
        /// What is wrong there.
        reason: &'static str,
    },
}

/// The failures that callers meet, as one type. Those of the roles of a cluster are not among them: they stand with the roles, in
/// [`cluster`](crate::cluster).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// See [`BudgetError`].
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// See [`ImportError`].
    #[error(transparent)]
    Import(#[from] ImportError),
    /// See [`CompileError`].
    #[error(transparent)]
    Compile(#[from] CompileError),
    /// See [`SourceError`].
    #[error(transparent)]
    Source(#[from] SourceError),
    /// See [`TraceError`].
    #[error(transparent)]
    Trace(#[from] TraceError),
    /// See [`InstanceError`].
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// See [`TextureError`].
    #[error(transparent)]
    Texture(#[from] TextureError),
    /// See [`SceneFileError`].
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    /// See [`RenderError`].
    #[error(transparent)]
    Render(#[from] RenderError),
    /// See [`ScheduleError`].
    #[error(transparent)]
    Schedule(#[from] ScheduleError),
    /// See [`AccessTraceError`].
    #[error(transparent)]
    AccessTrace(#[from] AccessTraceError),
    /// See [`TransportError`].
    #[error(transparent)]
    Transport(#[from] TransportError),
}
