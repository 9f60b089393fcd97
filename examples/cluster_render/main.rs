//! Makes one picture with many processes: coordinator, workers and readers over TCP or MPI, on this machine or on many.

#[macro_use]
#[path = "../common/mod.rs"]
mod common;

mod crew;
mod network;
mod nodes;
mod options;
#[cfg(feature = "mpi")]
mod ranks;
mod timeline;

use std::error::Error;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use common::arguments::{self, Arguments};
use options::Options;
use outcrop::transport::SharedKey;

fn main() -> ExitCode {
    arguments::run(run)
}

fn run(arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let Some(options) = Options::parse(arguments)? else {
        print!("{}", options::HELP);
        return Ok(ExitCode::SUCCESS);
    };
    if let Some(path) = &options.new_key {
        write_key(path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        return Ok(ExitCode::SUCCESS);
    }
    // A role or a host file says that the launcher only starts processes, and TCP carries them.
    if options.role.is_none() && is_launched() {
        return launched(&options);
    }
    nodes::run(&options)
}

/// Whether `mpirun`, `srun` or their like seem to have started more than this process.
fn is_launched() -> bool {
    let several = |name| std::env::var(name).is_ok_and(|ranks| ranks.trim() != "1");
    // PMIx tells a process its rank, but not how many there are; Slurm tells that of all that it starts.
    ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"].into_iter().any(several)
}

#[cfg(feature = "mpi")]
fn launched(options: &Options) -> Result<ExitCode, Box<dyn Error>> {
    // Without this each process would be a job by itself.
    if !outcrop::transport::MpiJob::is_launched() {
        return Err("started several times by srun, but not as ranks of MPI: say how they find each other \
            (--mpi=pmix for Open MPI, --mpi=pmi2 for MPICH; srun --mpi=list has what there is), \
            or have TCP carry them with --hosts"
            .into());
    }
    ranks::run(options)
}

#[cfg(not(feature = "mpi"))]
fn launched(_: &Options) -> Result<ExitCode, Box<dyn Error>> {
    Err("started several times by mpirun or srun, but built without MPI; build with --features mpi, \
        or give the processes their roles with --role or --hosts"
        .into())
}

/// A new key in a file that only its owner may read. Never over an existing file.
fn write_key(path: &Path) -> Result<(), Box<dyn Error>> {
    let mut open = OpenOptions::new();
    open.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut open, 0o600);
    writeln!(open.open(path)?, "{}", SharedKey::generate()?.to_hex())?;
    Ok(())
}
