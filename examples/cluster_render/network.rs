//! How the nodes reach each other.

use std::error::Error;
use std::sync::Arc;

#[cfg(feature = "mpi")]
use outcrop::transport::MpiJob;
use outcrop::transport::{SharedKey, TcpOptions, TcpTransport, Transport};

use crate::options::Options;

/// The network of a run.
pub enum Network<'a> {
    /// TCP between processes that hold this key.
    Tcp(&'a SharedKey),
    /// The ranks of an MPI job.
    #[cfg(feature = "mpi")]
    Mpi(&'a MpiJob),
}

/// What the coordinator's node is called in an MPI job.
#[cfg(feature = "mpi")]
pub const COORDINATOR: &str = "coordinator";

impl Network<'_> {
    /// The coordinator's node.
    pub fn coordinator(&self, options: &Options) -> Result<Box<dyn Transport>, Box<dyn Error>> {
        Ok(match self {
            Network::Tcp(key) => {
                let listen = options.listen.clone().unwrap_or_else(|| match options.role {
                    Some(_) => "127.0.0.1:7100".to_owned(),
                    None => "127.0.0.1:0".to_owned(),
                });
                let tcp = TcpOptions { listen: Some(listen), ..TcpOptions::connecting("coordinator") };
                Box::new(TcpTransport::open((*key).clone(), tcp)?)
            }
            #[cfg(feature = "mpi")]
            Network::Mpi(job) => {
                // Here is the model; all others wait for that.
                job.barrier();
                Box::new(job.open(COORDINATOR))
            }
        })
    }

    /// A reader's node.
    pub fn reader(&self, name: &str, listen: Option<&str>) -> Result<Box<dyn Transport>, Box<dyn Error>> {
        Ok(match self {
            Network::Tcp(key) => {
                let listen = Some(listen.unwrap_or("127.0.0.1:0").to_owned());
                let tcp = TcpOptions { listen, ..TcpOptions::connecting(name) };
                Box::new(TcpTransport::open((*key).clone(), tcp)?)
            }
            #[cfg(feature = "mpi")]
            Network::Mpi(job) => Box::new(job.open(name)),
        })
    }

    /// A worker's node that leads to the coordinator or to readers.
    pub fn worker(&self, name: &str) -> Result<Arc<dyn Transport>, Box<dyn Error>> {
        Ok(match self {
            Network::Tcp(key) => Arc::new(TcpTransport::open((*key).clone(), TcpOptions::connecting(name))?),
            #[cfg(feature = "mpi")]
            Network::Mpi(job) => Arc::new(job.open(name)),
        })
    }
}
