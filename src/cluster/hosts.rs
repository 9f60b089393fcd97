//! Host files: which node does what, and where.

use std::str::FromStr;

/// What a line of a host file makes a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostRole {
    /// Hands out tiles.
    Coordinator,
    /// Renders.
    Worker,
    /// Holds blocks.
    Reader,
}

/// A host file: one node a line, `HOST[:PORT] ROLE`, with the roles `coordinator`, `worker` and `reader`. Empty lines and what
/// follows a `#` do not count. There is exactly one coordinator; it and the readers need a port.
///
/// ```
/// let hosts: outcrop::cluster::Hosts = "
///     node1:7100 coordinator
///     node1:7101 reader    # beside the coordinator
///     node2 worker
///     node3 worker
/// ".parse()?;
/// assert_eq!(hosts.coordinator(), "node1:7100");
/// assert_eq!(hosts.count(outcrop::cluster::HostRole::Worker), 2);
/// # Ok::<(), outcrop::cluster::HostsError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hosts {
    nodes: Vec<(String, HostRole)>,
}

/// What is wrong with a host file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum HostsError {
    /// A line that means nothing.
    #[error("line {line} of the host file: {reason}; write it as `HOST[:PORT] coordinator|worker|reader`")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// Not just one coordinator.
    #[error("the host file has {count} coordinators; it must have one")]
    Coordinators {
        /// How many.
        count: usize,
    },
}

impl FromStr for Hosts {
    type Err = HostsError;

    fn from_str(text: &str) -> Result<Hosts, HostsError> {
        let mut nodes = Vec::new();
        for (line, text) in (1..).zip(text.lines()) {
            let error = |reason| HostsError::Line { line, reason };
            let text = text.split('#').next().unwrap_or_default();
            let mut words = text.split_whitespace();
            let Some(host) = words.next() else { continue };
            let role = match words.next() {
                Some("coordinator") => HostRole::Coordinator,
                Some("worker") => HostRole::Worker,
                Some("reader") => HostRole::Reader,
                _ => return Err(error("it names no role")),
            };
            if words.next().is_some() {
                return Err(error("there is something after the role"));
            }
            let port = host.rsplit_once(':').map(|(_, port)| port.parse::<u16>());
            if matches!(port, Some(Err(_))) || port.is_none() && role != HostRole::Worker {
                return Err(error("a coordinator or reader needs a port"));
            }
            nodes.push((host.to_owned(), role));
        }
        let hosts = Hosts { nodes };
        match hosts.count(HostRole::Coordinator) {
            1 => Ok(hosts),
            count => Err(HostsError::Coordinators { count }),
        }
    }
}

impl Hosts {
    /// All nodes in the order of the file: where, and what.
    pub fn nodes(&self) -> &[(String, HostRole)] {
        &self.nodes
    }

    /// How many nodes have a role.
    pub fn count(&self, role: HostRole) -> usize {
        self.nodes.iter().filter(|node| node.1 == role).count()
    }

    /// Where the coordinator listens.
    pub fn coordinator(&self) -> &str {
        self.nodes.iter().find(|node| node.1 == HostRole::Coordinator).map_or("", |node| &node.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_lines_are_named() {
        let line = |text: &str| match text.parse::<Hosts>() {
            Err(HostsError::Line { line, .. }) => line,
            other => panic!("{other:?}"),
        };
        assert_eq!(line("a:1 coordinator\n\nb\n"), 3);
        assert_eq!(line("a coordinator"), 1);
        assert_eq!(line("# x\na:99999 reader"), 2);
        assert_eq!(line("a:1 coordinator now"), 1);
        assert_eq!(line("a:1 cook"), 1);
        let count = |text: &str| text.parse::<Hosts>().unwrap_err();
        assert_eq!(count(""), HostsError::Coordinators { count: 0 });
        assert_eq!(count("a:1 coordinator\nb:1 coordinator"), HostsError::Coordinators { count: 2 });
    }
}
