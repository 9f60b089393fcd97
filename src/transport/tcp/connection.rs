//! A connection after its handshake: one thread reads, one writes.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

use super::super::PeerId;
use super::handshake::{Session, read_exact};
use super::record::{self, DATA_BYTES_MAX, LAST, MORE};
use crate::error::TransportError;

/// A peer that takes nothing for so long is given up.
const WRITE_TIME_MAX: Duration = Duration::from_secs(20);
/// The same when the connection is to end.
const FINISH_TIME_MAX: Duration = Duration::from_secs(2);

#[derive(Default)]
struct Queue {
    frames: VecDeque<Vec<u8>>,
    bytes: usize,
    /// What is in the queue is still sent, then the connection ends.
    finishing: bool,
    /// When it ends in any case, if it is finishing.
    finish_by: Option<Instant>,
    ended: bool,
}

pub(super) struct Connection {
    stream: TcpStream,
    queue: Mutex<Queue>,
    changed: Condvar,
    queue_bytes_max: usize,
    finish_time_max: Duration,
}

impl Connection {
    pub fn new(stream: TcpStream, queue_bytes_max: usize, finish_time_max: Duration) -> Connection {
        // Requests are small and somebody waits for them. If it cannot be set, they are slower.
        let _ = stream.set_nodelay(true);
        let _ = stream.set_write_timeout(Some(WRITE_TIME_MAX));
        Connection {
            stream,
            queue: Mutex::default(),
            changed: Condvar::new(),
            queue_bytes_max,
            finish_time_max,
        }
    }

    /// Queues a frame.
    pub fn push(&self, peer: PeerId, frame: Vec<u8>) -> Result<(), TransportError> {
        let mut queue = self.queue.lock();
        if queue.ended || queue.finishing {
            return Err(TransportError::NotConnected { peer: peer.0 });
        }
        if !queue.frames.is_empty() && queue.bytes + frame.len() > self.queue_bytes_max {
            return Err(TransportError::QueueFull { peer: peer.0 });
        }
        // A frame of no bytes takes room too.
        queue.bytes += frame.len().max(64);
        queue.frames.push_back(frame);
        self.changed.notify_one();
        Ok(())
    }

    /// Ends the connection when all that is queued is sent, or the time for that is over: a peer that takes little at a time must not
    /// hold up the one who waits for the end.
    pub fn finish(&self) {
        {
            let mut queue = self.queue.lock();
            queue.finishing = true;
            queue.finish_by = Instant::now().checked_add(self.finish_time_max);
        }
        self.changed.notify_one();
        let _ = self.stream.set_write_timeout(Some(FINISH_TIME_MAX));
        // The reader ends now. If the peer has hung up, there is nothing to shut.
        let _ = self.stream.shutdown(Shutdown::Read);
    }

    /// The reader has ended: so does the connection, unless it is being finished.
    pub fn unread(&self) {
        if !self.queue.lock().finishing {
            self.end();
        }
    }

    /// Ends the connection at once.
    pub fn end(&self) {
        self.queue.lock().ended = true;
        self.changed.notify_one();
        let _ = self.stream.shutdown(Shutdown::Both);
    }

    /// The writer's thread: seals and sends frames until the connection ends.
    pub fn write(&self, session: &Session) {
        // The one who connected has used nonce 0 for its proof.
        let mut nonce = u64::from(session.is_initiator());
        let mut records = Vec::new();
        loop {
            let frame = {
                let mut queue = self.queue.lock();
                loop {
                    if queue.ended {
                        return;
                    }
                    if let Some(frame) = queue.frames.pop_front() {
                        queue.bytes -= frame.len().max(64);
                        break frame;
                    }
                    if queue.finishing {
                        drop(queue);
                        return self.end();
                    }
                    self.changed.wait(&mut queue);
                }
            };
            let mut rest = &frame[..];
            loop {
                let (data, more) = rest.split_at(rest.len().min(DATA_BYTES_MAX));
                rest = more;
                let kind = if rest.is_empty() { LAST } else { MORE };
                records.clear();
                let sealed = record::write(session, nonce, &[kind], data, &mut records);
                nonce += 1;
                if sealed.is_err() || self.write_all(&records).is_err() {
                    // The reader says why.
                    return self.end();
                }
                if rest.is_empty() {
                    break;
                }
            }
        }
    }

    /// Writes all of it, unless the connection is to end by now.
    fn write_all(&self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            if self.queue.lock().finish_by.is_some_and(|by| Instant::now() >= by) {
                return Err(io::ErrorKind::TimedOut.into());
            }
            match (&self.stream).write(bytes) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => bytes = &bytes[count..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The reader's thread: gives frames to `put` until the connection ends or `put` says so. Gives the reason.
    pub fn read(
        &self,
        session: &Session,
        frame_bytes_max: usize,
        frame_time_max: Duration,
        mut put: impl FnMut(Vec<u8>) -> bool,
    ) -> String {
        let mut nonce = u64::from(!session.is_initiator());
        let mut plain = Vec::new();
        loop {
            // A peer may be silent for any time between frames.
            let first = match self.first_byte() {
                Ok(first) => first,
                Err(reason) => return reason,
            };
            let deadline = Instant::now() + frame_time_max;
            let mut first = Some(first);
            let mut frame = Vec::new();
            loop {
                let mut read = |into: &mut [u8]| match first.take() {
                    Some(byte) => {
                        into[0] = byte;
                        read_exact(&self.stream, &mut into[1..], deadline)
                    }
                    None => read_exact(&self.stream, into, deadline),
                };
                if let Err(reason) = record::read(session, nonce, DATA_BYTES_MAX, &mut read, &mut plain) {
                    return format!("in the middle of a frame: {reason}");
                }
                nonce += 1;
                let (kind, data) =
                    plain.split_first().map_or((u8::MAX, &[][..]), |(kind, data)| (*kind, data));
                if frame.len() + data.len() > frame_bytes_max {
                    return format!("it sent a frame of more than {frame_bytes_max} bytes");
                }
                frame.extend_from_slice(data);
                match kind {
                    LAST => break,
                    MORE if data.len() == DATA_BYTES_MAX => {}
                    _ => return "it sent a record that cannot be".to_owned(),
                }
            }
            if !put(frame) {
                return "the connection was ended here".to_owned();
            }
        }
    }

    fn first_byte(&self) -> Result<u8, String> {
        self.stream.set_read_timeout(None).map_err(|error| error.to_string())?;
        let mut byte = [0; 1];
        loop {
            match (&self.stream).read(&mut byte) {
                Ok(0) => return Err("it hung up".to_owned()),
                Ok(_) => return Ok(byte[0]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.to_string()),
            }
        }
    }
}
