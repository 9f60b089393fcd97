//! Messages on their way: MPI sends and receives that do not wait, and own their bytes.
//!
//! The crate `mpi` ties such an operation to a buffer that is borrowed for a whole scope, which fits a step of a computation but not a
//! service that sends and receives for hours. So this file calls MPI itself. While a message is on its way MPI alone has its bytes; nothing
//! in Rust refers to them.

use std::mem::ManuallyDrop;
use std::os::raw::c_int;
use std::ptr;

use ::mpi::Rank;
use ::mpi::ffi;
use ::mpi::raw::AsRaw;
use ::mpi::topology::{Communicator, SimpleCommunicator};

/// All messages of the transport have this tag; the standard promises tags up to 32,767.
pub const TAG: c_int = 0x6f63;

/// A message on its way. Bound to the thread that made it, the only one that calls MPI. One that is dropped on its way leaves
/// its bytes to MPI for good.
pub struct Flight {
    start: *mut u8,
    length: usize,
    capacity: usize,
    /// None when it has arrived.
    request: Option<ffi::MPI_Request>,
}

impl Flight {
    /// Starts to send `bytes`.
    pub fn send(world: &SimpleCommunicator, to: Rank, bytes: Vec<u8>) -> Flight {
        Flight::start(world, bytes, |flight, count, request| {
            // SAFETY: `start` and `count` are a live allocation that nobody else touches until MPI says that the request is done.
            unsafe {
                let kind = ffi::RSMPI_UINT8_T;
                ffi::MPI_Isend(flight.start.cast(), count, kind, to, TAG, world.as_raw(), request)
            }
        })
    }

    /// Starts to receive the next message of `from`, which has `length` bytes.
    pub fn receive(world: &SimpleCommunicator, from: Rank, length: usize) -> Flight {
        Flight::start(world, vec![0; length], |flight, count, request| {
            // SAFETY: as in `send`; MPI writes at most `count` bytes.
            unsafe {
                let kind = ffi::RSMPI_UINT8_T;
                ffi::MPI_Irecv(flight.start.cast(), count, kind, from, TAG, world.as_raw(), request)
            }
        })
    }

    fn start(
        world: &SimpleCommunicator,
        bytes: Vec<u8>,
        begin: impl FnOnce(&Flight, c_int, *mut ffi::MPI_Request) -> c_int,
    ) -> Flight {
        let mut bytes = ManuallyDrop::new(bytes);
        let (start, length, capacity) = (bytes.as_mut_ptr(), bytes.len(), bytes.capacity());
        // SAFETY: a constant of the MPI library, read only.
        let mut request = unsafe { ffi::RSMPI_REQUEST_NULL };
        let mut flight = Flight { start, length, capacity, request: None };
        // Frames are at most a megabyte.
        let count = c_int::try_from(length).unwrap_or(c_int::MAX);
        // MPI ends the job at an error unless somebody changed that.
        if begin(&flight, count, &raw mut request) != 0 {
            world.abort(1);
        }
        flight.request = Some(request);
        flight
    }

    /// Whether it has arrived, or its bytes have been sent. Lets MPI work.
    pub fn is_done(&mut self) -> bool {
        let Some(request) = &mut self.request else { return true };
        let mut done: c_int = 0;
        // SAFETY: a request that was started and is not done; its length was known when a receive was started, so no status is needed.
        let code = unsafe { ffi::MPI_Test(ptr::from_mut(request), &raw mut done, ffi::RSMPI_STATUS_IGNORE) };
        if code == 0 && done != 0 {
            self.request = None;
        }
        self.request.is_none()
    }

    /// The bytes; `None` if it is still on its way.
    pub fn into_bytes(self) -> Option<Vec<u8>> {
        if self.request.is_some() {
            return None;
        }
        let flight = ManuallyDrop::new(self);
        // SAFETY: the parts of a vector that was taken apart in `start`; MPI is done with it, and dropping this does not free it again.
        Some(unsafe { Vec::from_raw_parts(flight.start, flight.length, flight.capacity) })
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        if self.request.is_none() {
            // SAFETY: as in `into_bytes`.
            drop(unsafe { Vec::from_raw_parts(self.start, self.length, self.capacity) });
        }
    }
}
