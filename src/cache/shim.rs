//! The synchronisation primitives that the cache uses, named once, so that the very same code runs on the machine's
//! primitives and, in tests, on those of a model checker that tries many thread schedules.

use std::ops::DerefMut;
use std::sync::atomic::Ordering;

/// A family of primitives.
pub(super) trait Primitives: 'static {
    type Word: AtomicWord;
    type Mutex<T: Send>: Send + Sync;
    type Guard<'a, T: Send + 'a>: DerefMut<Target = T>;
    type Condvar: Send + Sync;

    fn mutex<T: Send>(value: T) -> Self::Mutex<T>;
    fn lock<T: Send>(mutex: &Self::Mutex<T>) -> Self::Guard<'_, T>;
    fn try_lock<T: Send>(mutex: &Self::Mutex<T>) -> Option<Self::Guard<'_, T>>;
    fn condvar() -> Self::Condvar;
    /// Gives the lock up while it waits; may return without a notification.
    fn wait<'a, T: Send + 'a>(condvar: &Self::Condvar, guard: Self::Guard<'a, T>) -> Self::Guard<'a, T>;
    fn notify_all(condvar: &Self::Condvar);
}

/// An atomic u64, as `std` has it.
pub(super) trait AtomicWord: Send + Sync {
    fn new(value: u64) -> Self;
    fn load(&self, order: Ordering) -> u64;
    fn store(&self, value: u64, order: Ordering);
    fn fetch_add(&self, value: u64, order: Ordering) -> u64;
    fn fetch_sub(&self, value: u64, order: Ordering) -> u64;
    fn compare_exchange(
        &self,
        current: u64,
        new: u64,
        success: Ordering,
        failure: Ordering,
    ) -> Result<u64, u64>;
}

macro_rules! atomic_word {
    ($atomic:ty) => {
        impl AtomicWord for $atomic {
            fn new(value: u64) -> Self {
                <$atomic>::new(value)
            }
            fn load(&self, order: Ordering) -> u64 {
                self.load(order)
            }
            fn store(&self, value: u64, order: Ordering) {
                self.store(value, order);
            }
            fn fetch_add(&self, value: u64, order: Ordering) -> u64 {
                self.fetch_add(value, order)
            }
            fn fetch_sub(&self, value: u64, order: Ordering) -> u64 {
                self.fetch_sub(value, order)
            }
            fn compare_exchange(
                &self,
                current: u64,
                new: u64,
                success: Ordering,
                failure: Ordering,
            ) -> Result<u64, u64> {
                self.compare_exchange(current, new, success, failure)
            }
        }
    };
}

/// The machine's: `std` atomics and `parking_lot` locks, which neither poison nor allocate.
pub(super) struct Native;

atomic_word!(std::sync::atomic::AtomicU64);

impl Primitives for Native {
    type Word = std::sync::atomic::AtomicU64;
    type Mutex<T: Send> = parking_lot::Mutex<T>;
    type Guard<'a, T: Send + 'a> = parking_lot::MutexGuard<'a, T>;
    type Condvar = parking_lot::Condvar;

    fn mutex<T: Send>(value: T) -> parking_lot::Mutex<T> {
        parking_lot::Mutex::new(value)
    }

    fn lock<T: Send>(mutex: &parking_lot::Mutex<T>) -> parking_lot::MutexGuard<'_, T> {
        mutex.lock()
    }

    fn try_lock<T: Send>(mutex: &parking_lot::Mutex<T>) -> Option<parking_lot::MutexGuard<'_, T>> {
        mutex.try_lock()
    }

    fn condvar() -> parking_lot::Condvar {
        parking_lot::Condvar::new()
    }

    fn wait<'a, T: Send + 'a>(
        condvar: &parking_lot::Condvar,
        mut guard: parking_lot::MutexGuard<'a, T>,
    ) -> parking_lot::MutexGuard<'a, T> {
        condvar.wait(&mut guard);
        guard
    }

    fn notify_all(condvar: &parking_lot::Condvar) {
        condvar.notify_all();
    }
}

#[cfg(test)]
pub(super) use checked::Checked;

#[cfg(test)]
mod checked {
    use super::*;
    use shuttle::sync::{Condvar, Mutex, MutexGuard, PoisonError, TryLockError, atomic::AtomicU64};

    /// The model checker's. It explores interleavings, with sequentially consistent memory; the orderings are argued
    /// in comments.
    pub(in super::super) struct Checked;

    atomic_word!(AtomicU64);

    // Shuttle's locks poison as `std`'s do, and by mistake too: all its threads run on one thread of the machine, so a
    // guard that is dropped while another thread unwinds looks as if it were dropped by that. Hence `into_inner`.

    impl Primitives for Checked {
        type Word = AtomicU64;
        type Mutex<T: Send> = Mutex<T>;
        type Guard<'a, T: Send + 'a> = MutexGuard<'a, T>;
        type Condvar = Condvar;

        fn mutex<T: Send>(value: T) -> Mutex<T> {
            Mutex::new(value)
        }

        fn lock<T: Send>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
            mutex.lock().unwrap_or_else(PoisonError::into_inner)
        }

        fn try_lock<T: Send>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
            match mutex.try_lock() {
                Ok(guard) => Some(guard),
                Err(TryLockError::Poisoned(error)) => Some(error.into_inner()),
                Err(TryLockError::WouldBlock) => None,
            }
        }

        fn condvar() -> Condvar {
            Condvar::new()
        }

        fn wait<'a, T: Send + 'a>(condvar: &Condvar, guard: MutexGuard<'a, T>) -> MutexGuard<'a, T> {
            condvar.wait(guard).unwrap_or_else(PoisonError::into_inner)
        }

        fn notify_all(condvar: &Condvar) {
            condvar.notify_all();
        }
    }
}
