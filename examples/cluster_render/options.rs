//! The command line of `cluster_render`.

use std::error::Error;
use std::path::PathBuf;
use std::time::Duration;

use outcrop::cluster::{HostRole, Hosts};
use outcrop::render::{ImageFormat, WaitingRays};
use outcrop::units::Bytes;

use crate::common::arguments::Arguments;
use crate::common::place::place_of;

pub const HELP: &str = "\
cluster_render: makes one picture with many processes, on this machine or on many

    cargo run --release --example cluster_render                 everything here: coordinator, 3 workers, 2 readers
    cluster_render --role coordinator MODEL --listen HOST:PORT   on one machine
    cluster_render --role worker [MODEL] --connect HOST:PORT     on others, as many as there are; at any time
    cluster_render --role reader MODEL --connect HOST:PORT --listen HOST:PORT
    cluster_render --hosts FILE [--node N] [MODEL]               role and addresses from a host file
    mpirun -n 6 cluster_render [MODEL]                           built with --features mpi: rank 0 is the coordinator, then
                                                                 come --readers, and the others are workers

MODEL is a compiled .outcrop file, the same on all nodes. A worker without it takes its blocks from the readers. Without a MODEL,
the coordinator makes gears in code. docs/cluster.md tells more.

key     all nodes hold the same key. From --key-file, or from the variable OUTCROP_KEY; on one machine it is made up
    --key-file FILE         64 hexadecimal digits; nobody else may read the file
    --new-key FILE          makes such a file and ends
network
    --role ROLE             coordinator, worker or reader
    --listen HOST:PORT      where this node listens (127.0.0.1:7100, or any port of 127.0.0.1 for a reader)
    --advertise HOST:PORT   where others reach this reader, if that is not what it listens at
    --connect HOST:PORT     where the coordinator is
    --hosts FILE            lines `HOST[:PORT] coordinator|worker|reader`
    --node N                this node's line in it, from 0; the variable SLURM_PROCID if not given
    --serve HOST:PORT       a worker with the model also serves its part of the blocks from memory, here: workers ask each other before
                            their disks. It counts among --readers, and takes a quarter of --memory
    --peers                 everything here, and the workers serve each other: there are no readers
    --ship HOST:PORT        the coordinator serves the file, too, here; for workers without it, where there is no reader
    --name NAME             what this node calls itself in the logs of others
    --patience SECONDS      how long to wait for a coordinator, or for any worker (60)
picture
    -o, --output FILE       .png, .exr or .pfm (cluster.png); a map of who rendered what and a timeline go beside it
    --size WxH              768x768; one number for a square
    --spp N                 samples per pixel (1)
    --gears N               wheels per edge of the gears (4)
    --checkpoint FILE       what is done, for a coordinator that is started again (OUTPUT.checkpoint)
    --verify                render the picture by this process alone, too, and compare bit by bit
    --small                 a small picture of small gears, for a quick look
resources
    --workers N             workers that are started, or expected (3)
    --readers N             readers that are started, or expected (2; 0 with --role coordinator)
    --lanes N               threads of a worker (1)
    --memory BYTES          budget of each node (128MiB)
    --waiting N             at most N rays of a worker wait for blocks that it does not hold while others are traced; auto or never (never)
    --loaders N             threads of a worker beside its lanes that load blocks for rays that wait (0)
    --keep FILE             a worker without the model makes itself a copy while it renders, and goes on with an unfinished one
    --verbose               tell who comes and goes
";

#[derive(Clone)]
pub struct Options {
    pub model: Option<PathBuf>,
    pub role: Option<HostRole>,
    pub key_file: Option<PathBuf>,
    pub new_key: Option<PathBuf>,
    pub listen: Option<String>,
    pub advertise: Option<String>,
    pub connect: Option<String>,
    pub name: Option<String>,
    pub patience: Duration,
    pub output: PathBuf,
    pub size: [u32; 2],
    pub samples_per_pixel: u32,
    pub gears_n: u32,
    /// Triangles for one of the model.
    pub is_small: bool,
    pub checkpoint: PathBuf,
    pub verify: bool,
    pub workers: u32,
    pub readers: usize,
    /// `--readers`, if it was given.
    pub readers_asked: Option<usize>,
    /// Where a worker serves blocks.
    pub serve: Option<String>,
    /// Whether workers that are started here serve blocks.
    pub peers: bool,
    /// Where the coordinator serves the file.
    pub ship: Option<String>,
    pub keep: Option<PathBuf>,
    pub lanes: u16,
    pub memory: Bytes,
    pub waiting: WaitingRays,
    pub loaders: u32,
    pub verbose: bool,
}

impl Options {
    /// `None` if help was asked for.
    pub fn parse(mut arguments: Arguments) -> Result<Option<Options>, Box<dyn Error>> {
        let mut options = Options {
            model: None,
            role: None,
            key_file: None,
            new_key: None,
            listen: None,
            advertise: None,
            connect: None,
            name: None,
            patience: Duration::from_secs(60),
            output: PathBuf::from("cluster.png"),
            size: [768, 768],
            samples_per_pixel: 1,
            gears_n: 4,
            is_small: false,
            checkpoint: PathBuf::new(),
            verify: false,
            workers: 3,
            readers: 2,
            readers_asked: None,
            serve: None,
            peers: false,
            ship: None,
            keep: None,
            lanes: 1,
            memory: Bytes::mib(128),
            waiting: WaitingRays::Never,
            loaders: 0,
            verbose: false,
        };
        let (mut checkpoint, mut readers, mut size, mut gears_n) = (None, None, None, None);
        let (mut hosts, mut node) = (None, None);
        while let Some(name) = arguments.option_or_model(&mut options.model)? {
            match name.as_str() {
                "-h" | "--help" => return Ok(None),
                "--role" => {
                    let roles = [
                        ("coordinator", HostRole::Coordinator),
                        ("worker", HostRole::Worker),
                        ("reader", HostRole::Reader),
                    ];
                    options.role = Some(arguments.choice(&roles)?);
                }
                "--key-file" => options.key_file = Some(arguments.path()?),
                "--new-key" => options.new_key = Some(arguments.path()?),
                "--listen" => options.listen = Some(arguments.text()?),
                "--advertise" => options.advertise = Some(arguments.text()?),
                "--connect" => options.connect = Some(arguments.text()?),
                "--hosts" => hosts = Some(arguments.path()?),
                "--node" => node = Some(arguments.value()?),
                "--name" => options.name = Some(arguments.text()?),
                "--patience" => options.patience = Duration::from_secs(arguments.value()?),
                "-o" | "--output" => options.output = arguments.path()?,
                "--size" => size = Some(arguments.size()?),
                "--spp" => options.samples_per_pixel = arguments.value()?,
                "--gears" => gears_n = Some(arguments.value()?),
                "--checkpoint" => checkpoint = Some(arguments.path()?),
                "--verify" => options.verify = true,
                "--small" => options.is_small = true,
                "--workers" => options.workers = arguments.value()?,
                "--readers" => readers = Some(arguments.value()?),
                "--serve" => options.serve = Some(arguments.text()?),
                "--peers" => options.peers = true,
                "--ship" => options.ship = Some(arguments.text()?),
                "--keep" => options.keep = Some(arguments.path()?),
                "--lanes" => options.lanes = arguments.value()?,
                "--memory" => options.memory = arguments.value()?,
                "--waiting" => options.waiting = arguments.value()?,
                "--loaders" => options.loaders = arguments.value()?,
                "--verbose" => options.verbose = true,
                _ => return Err(arguments.unknown()),
            }
        }
        if options.is_small {
            (options.size, options.gears_n) = ([200, 150], 1);
        }
        options.size = size.unwrap_or(options.size);
        options.gears_n = gears_n.unwrap_or(options.gears_n);
        let alone = match options.role {
            None if options.peers => options.workers as usize,
            None => 2,
            Some(_) => 0,
        };
        options.readers_asked = readers;
        options.readers = readers.unwrap_or(alone);
        if hosts.is_none() && node.is_some() {
            return Err("--node: a line of which host file? Give it with --hosts".into());
        }
        // Else a picture of this machine's own would be made, and nobody join the other.
        if hosts.is_none() && options.role.is_none() && options.connect.is_some() {
            return Err("--connect: as what? Give --role worker or --role reader".into());
        }
        if let Some(path) = hosts {
            let text =
                std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            options.take_place(&text.parse()?, node)?;
        }
        options.checkpoint = checkpoint.unwrap_or_else(|| options.output.with_extension("checkpoint"));
        ImageFormat::of_path(&options.output)?;
        // A checkpoint is removed when the picture is done.
        let [map, timeline] = options.beside_output();
        let written = [&options.output, &map, &timeline].map(|path| place_of(path));
        if written.contains(&place_of(&options.checkpoint)) {
            return Err(format!(
                "--checkpoint {}: a file of that name is written with the picture; choose another",
                options.checkpoint.display()
            )
            .into());
        }
        if options.workers == 0 || options.lanes == 0 {
            return Err("--workers and --lanes must be at least 1".into());
        }
        if options.serve.is_some() && options.model.is_none() {
            return Err(
                "--serve: a worker without the model has nothing to serve; name the compiled file".into()
            );
        }
        if options.peers
            && (options.role.is_some() || readers.is_some_and(|count| count != options.workers as usize))
        {
            return Err("--peers: it is for starting everything here, with as many readers as workers; elsewhere, see --serve".into());
        }
        Ok(Some(options))
    }

    /// The map of who rendered what, and the timeline.
    pub fn beside_output(&self) -> [PathBuf; 2] {
        let stem = self.output.file_stem().unwrap_or_default().to_string_lossy();
        ["map.png", "timeline.svg"].map(|what| self.output.with_file_name(format!("{stem}-{what}")))
    }

    /// Takes role and addresses from a host file.
    fn take_place(&mut self, hosts: &Hosts, node: Option<usize>) -> Result<(), Box<dyn Error>> {
        let rank = std::env::var("SLURM_PROCID").ok().and_then(|rank| rank.parse().ok());
        let node: usize = node
            .or(rank)
            .ok_or("--hosts: which node is this? Give its line with --node, or start it by srun")?;
        let nodes = hosts.nodes();
        let (address, role) = nodes
            .get(node)
            .ok_or_else(|| format!("--node {node}: the host file has {} nodes", nodes.len()))?;
        self.role = Some(*role);
        self.workers = (hosts.count(HostRole::Worker) as u32).max(1);
        self.readers = hosts.count(HostRole::Reader);
        self.connect = Some(hosts.coordinator().to_owned());
        self.name.get_or_insert_with(|| format!("node {node}, {address}"));
        if *role != HostRole::Worker {
            // A name that others know this node by is a name that it can listen at.
            self.listen.get_or_insert_with(|| address.clone());
            self.advertise.get_or_insert_with(|| address.clone());
        }
        Ok(())
    }
}
