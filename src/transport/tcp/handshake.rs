//! Who may connect: a plain greeting with the version, then Noise.
//!
//! The one who connects sends `greeting | length | message 1`, the other answers `greeting | length | message 2`, the first proves
//! that it is not a recording by a first record, which holds its name. A stranger can make a node read 12 + 2 + 112 bytes
//! and do one key agreement, no more.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use snow::{Builder, HandshakeState, StatelessTransportState};

use super::super::SharedKey;
use super::record;

/// The version of what is said between nodes, handshake and messages together. Nodes of different versions do not work together.
pub const PROTOCOL_VERSION: u16 = 1;

/// Like the signature of PNG, it does not survive a conversion of text, and no protocol of text begins like it.
const MAGIC: [u8; 8] = *b"\x89ocnet\r\n";
const GREETING_BYTES: usize = 12;

const PATTERN: &str = "Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s";

/// Bytes of a name.
const NAME_BYTES_MAX: usize = 64;
/// Key, tag, and a name.
const MESSAGE_BYTES_MAX: usize = 32 + 16 + NAME_BYTES_MAX;

/// What a greeting says beside its version.
const WELCOME: u16 = 0;
const OTHER_VERSION: u16 = 1;

/// The keys of a connection.
pub(super) type Session = StatelessTransportState;

fn greeting(status: u16) -> [u8; GREETING_BYTES] {
    let mut bytes = [0; GREETING_BYTES];
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..10].copy_from_slice(&PROTOCOL_VERSION.to_le_bytes());
    bytes[10..].copy_from_slice(&status.to_le_bytes());
    bytes
}

/// The version and the status of a greeting.
fn parse_greeting(bytes: &[u8; GREETING_BYTES]) -> Option<(u16, u16)> {
    let number = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    (bytes[..8] == MAGIC).then(|| (number(8), number(10)))
}

fn builder<'k>(key: &'k SharedKey, prologue: &'k [u8]) -> Result<Builder<'k>, String> {
    let parameters = PATTERN.parse().map_err(|error| format!("{PATTERN}: {error}"))?;
    let builder = Builder::new(parameters).psk(0, key.bytes()).and_then(|builder| builder.prologue(prologue));
    builder.map_err(|error| error.to_string())
}

/// 32 random bytes from the system.
pub(in super::super) fn random_bytes() -> Result<[u8; 32], String> {
    let parameters = PATTERN.parse().map_err(|error| format!("{PATTERN}: {error}"))?;
    // A private key is 32 bytes from the system's generator.
    let pair = Builder::new(parameters).generate_keypair().map_err(|error| error.to_string())?;
    pair.private.try_into().map_err(|_| "the generator gave a wrong number of bytes".to_owned())
}

/// The side that was connected to. Gives the keys and the peer's name.
pub(super) fn accept(
    stream: &TcpStream,
    key: &SharedKey,
    name: &str,
    deadline: Instant,
) -> Result<(Session, String), String> {
    let mut line = Line { stream, deadline };
    let mut theirs = [0; GREETING_BYTES];
    line.read(&mut theirs)?;
    let (version, _) = parse_greeting(&theirs).ok_or("it does not speak this protocol")?;
    if version != PROTOCOL_VERSION {
        line.write(&greeting(OTHER_VERSION))?;
        return Err(format!("it speaks version {version}, this node version {PROTOCOL_VERSION}"));
    }
    let mut noise = builder(key, &theirs)?.build_responder().map_err(|error| error.to_string())?;
    line.read_message(&mut noise).map_err(|error| format!("it does not hold the key ({error})"))?;
    let answer = write_message(&mut noise, name)?;
    line.write(&[&greeting(WELCOME)[..], &answer].concat())?;
    let session = noise.into_stateless_transport_mode().map_err(|error| error.to_string())?;
    // Message 1 may be a recording. Only who holds the key and was there to see message 2 can make this.
    let mut first = Vec::new();
    let mut read = |into: &mut [u8]| line.read(into);
    record::read(&session, 0, NAME_BYTES_MAX, &mut read, &mut first)
        .map_err(|error| format!("it does not hold the key ({error})"))?;
    let name = first.get(1..).unwrap_or(&[]);
    Ok((session, readable(name)))
}

/// The side that connects.
pub(super) fn connect(
    stream: &TcpStream,
    key: &SharedKey,
    name: &str,
    deadline: Instant,
) -> Result<Session, String> {
    let mut line = Line { stream, deadline };
    let hello = greeting(WELCOME);
    let mut noise = builder(key, &hello)?.build_initiator().map_err(|error| error.to_string())?;
    let first = write_message(&mut noise, "")?;
    line.write(&[&hello[..], &first].concat())?;
    let mut theirs = [0; GREETING_BYTES];
    line.read(&mut theirs).map_err(|error| format!("{error}; does it hold another key?"))?;
    let (version, status) =
        parse_greeting(&theirs).ok_or("what answers there does not speak this protocol")?;
    if version != PROTOCOL_VERSION || status != WELCOME {
        return Err(format!("it speaks version {version}, this node version {PROTOCOL_VERSION}"));
    }
    line.read_message(&mut noise).map_err(|error| format!("it does not hold the key ({error})"))?;
    let session = noise.into_stateless_transport_mode().map_err(|error| error.to_string())?;
    let mut proof = Vec::new();
    record::write(&session, 0, &[record::LAST], cut(name), &mut proof)?;
    line.write(&proof)?;
    Ok(session)
}

fn cut(name: &str) -> &[u8] {
    &name.as_bytes()[..name.len().min(NAME_BYTES_MAX)]
}

/// A name that can be printed.
fn readable(name: &[u8]) -> String {
    let text = String::from_utf8_lossy(&name[..name.len().min(NAME_BYTES_MAX)]);
    text.chars().filter(|c| !c.is_control()).collect()
}

/// A handshake message with its length before it.
fn write_message(noise: &mut HandshakeState, payload: &str) -> Result<Vec<u8>, String> {
    let mut message = vec![0; 2 + MESSAGE_BYTES_MAX];
    let length = noise.write_message(cut(payload), &mut message[2..]).map_err(|error| error.to_string())?;
    message.truncate(2 + length);
    // At most `MESSAGE_BYTES_MAX`.
    message[..2].copy_from_slice(&(length as u16).to_le_bytes());
    Ok(message)
}

/// A socket with one deadline for all that happens on it.
struct Line<'s> {
    stream: &'s TcpStream,
    deadline: Instant,
}

impl Line<'_> {
    fn left(&self) -> Result<Duration, String> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() { Err("it took too long".to_owned()) } else { Ok(left) }
    }

    fn read(&mut self, into: &mut [u8]) -> Result<(), String> {
        read_exact(self.stream, into, self.deadline)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), String> {
        let result = self.stream.set_write_timeout(Some(self.left()?));
        // A handshake's few bytes always fit the socket's buffer, so this does not take many rounds.
        result.and_then(|()| (&mut &*self.stream).write_all(bytes)).map_err(|error| error.to_string())
    }

    fn read_message(&mut self, noise: &mut HandshakeState) -> Result<(), String> {
        let mut length = [0; 2];
        self.read(&mut length)?;
        let length = usize::from(u16::from_le_bytes(length));
        let mut message = [0; MESSAGE_BYTES_MAX];
        let message = message.get_mut(..length).ok_or("a handshake message is too long")?;
        self.read(message)?;
        let mut payload = [0; MESSAGE_BYTES_MAX];
        noise.read_message(message, &mut payload).map(|_| ()).map_err(|error| error.to_string())
    }
}

/// Fills `into` before `deadline`, however slowly the bytes come.
pub(super) fn read_exact(mut stream: &TcpStream, into: &mut [u8], deadline: Instant) -> Result<(), String> {
    let mut filled = 0;
    while filled < into.len() {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err("it took too long".to_owned());
        }
        stream.set_read_timeout(Some(left)).map_err(|error| error.to_string())?;
        match stream.read(&mut into[filled..]) {
            Ok(0) => return Err("it hung up".to_owned()),
            Ok(count) => filled += count,
            Err(error) => match error.kind() {
                io::ErrorKind::Interrupted | io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {}
                _ => return Err(error.to_string()),
            },
        }
    }
    Ok(())
}
