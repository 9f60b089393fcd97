//! The roles by rank: `mpirun -n 6 cluster_render`.

use std::error::Error;
use std::process::ExitCode;

use outcrop::cluster::HostRole;
use outcrop::transport::MpiJob;

use crate::common::interrupt::Interrupt;
use crate::network::{COORDINATOR, Network};
use crate::nodes;
use crate::options::Options;

/// Runs the role of this rank: the coordinator is rank 0, then come the readers, then the workers. An error of one ends all.
pub fn run(options: &Options) -> Result<ExitCode, Box<dyn Error>> {
    let job = MpiJob::start()?;
    let (hook, abort) = (std::panic::take_hook(), job.aborter());
    // A thread that panics may leave others of its process waiting, and all other ranks.
    std::panic::set_hook(Box::new(move |panic| {
        hook(panic);
        abort(101);
    }));
    match role(options, &job) {
        Ok(code) => Ok(code),
        Err(error) => {
            eprintln!("rank {}: {error}", job.rank());
            job.abort(1)
        }
    }
}

fn role(options: &Options, job: &MpiJob) -> Result<ExitCode, Box<dyn Error>> {
    let (rank, size) = (job.rank(), job.size());
    let mut options = options.clone();
    // Half of what is left beside the coordinator and a worker, at most as many as without MPI.
    options.readers = options.readers_asked.unwrap_or(size.saturating_sub(2).min(4) / 2);
    if size == 1 {
        // Each process would say the same of its own job.
        return Err("MPI knows of this process alone: start more with -n, by the launcher of the MPI library that this was built with \
            (mpirun.mpich and srun --mpi=pmi2 for MPICH; mpirun.openmpi and srun --mpi=pmix for Open MPI)"
            .into());
    }
    if size < options.readers + 2 {
        return Err(format!(
            "{size} ranks are too few for a coordinator, {} readers and a worker",
            options.readers
        )
        .into());
    }
    options.workers = u32::try_from(size - 1 - options.readers)?;
    let interrupt = Interrupt::install()?;
    let network = Network::Mpi(job);
    if rank == 0 {
        options.role = Some(HostRole::Coordinator);
        return nodes::coordinate(&options, &network, &interrupt);
    }
    let path = nodes::model_path(&options);
    options.connect = Some(MpiJob::address_of(0, COORDINATOR));
    // The coordinator makes the model, if none was given.
    job.barrier();
    if rank <= options.readers {
        let name = format!("reader {rank}");
        (options.advertise, options.name) = (Some(MpiJob::address_of(rank, &name)), Some(name));
        options.model = Some(path);
        nodes::read(&options, &network, &interrupt)
    } else {
        options.name = Some(format!("worker {}", rank - options.readers));
        // Where the nodes share no disk, a worker takes its blocks from the readers.
        options.model = (options.readers == 0 || path.exists()).then_some(path);
        nodes::work(&options, &network, &interrupt)
    }
}
