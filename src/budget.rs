//! One budget that every slot, tree node, queue, scratch buffer and film draws on (I1).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::BudgetError;
use crate::units::Bytes;

/// A limit on the anonymous memory of one job, shared by all parts of it (cloning shares, it does not copy).
///
/// Accounting is by declaration: a part reserves before it allocates and the reservation is given back
/// when it is dropped. The sum of live reservations never exceeds the limit. What the allocator, the
/// stacks and the program text add is not counted; invariant I1 allows 32 MiB for it.
#[derive(Clone, Debug)]
pub struct MemoryBudget {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    limit: u64,
    used: AtomicU64,
    peak: AtomicU64,
}

impl MemoryBudget {
    /// A budget of `limit` bytes with nothing reserved.
    pub fn new(limit: Bytes) -> MemoryBudget {
        MemoryBudget {
            shared: Arc::new(Shared { limit: limit.0, used: AtomicU64::new(0), peak: AtomicU64::new(0) }),
        }
    }

    /// The limit given to [`MemoryBudget::new`].
    pub fn limit(&self) -> Bytes {
        Bytes(self.shared.limit)
    }

    /// The sum of live reservations.
    pub fn used(&self) -> Bytes {
        Bytes(self.shared.used.load(Ordering::Relaxed))
    }

    /// The largest sum of live reservations so far.
    pub fn peak(&self) -> Bytes {
        Bytes(self.shared.peak.load(Ordering::Relaxed))
    }

    /// What can still be reserved.
    pub fn available(&self) -> Bytes {
        Bytes(self.shared.limit.saturating_sub(self.used().0))
    }

    /// Takes `bytes` from the budget for the part named `purpose` until the reservation is dropped.
    ///
    /// # Errors
    /// [`BudgetError`] if less is left; nothing is reserved then.
    pub fn reserve(&self, bytes: Bytes, purpose: &'static str) -> Result<Reservation, BudgetError> {
        let shared = &self.shared;
        let taken = shared.used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |used| {
            used.checked_add(bytes.0).filter(|sum| *sum <= shared.limit)
        });
        match taken {
            Ok(before) => {
                shared.peak.fetch_max(before + bytes.0, Ordering::Relaxed);
                Ok(Reservation { budget: self.clone(), bytes: bytes.0 })
            }
            Err(used) => Err(BudgetError {
                purpose,
                needed: bytes,
                available: Bytes(shared.limit.saturating_sub(used)),
                limit: Bytes(shared.limit),
            }),
        }
    }
}

/// Bytes taken from a [`MemoryBudget`]; given back on drop.
#[derive(Debug)]
pub struct Reservation {
    budget: MemoryBudget,
    bytes: u64,
}

impl Reservation {
    /// How much is reserved.
    pub fn bytes(&self) -> Bytes {
        Bytes(self.bytes)
    }

    /// Takes more of the same budget until `bytes` are reserved; what is there already stays.
    pub(crate) fn grow(&mut self, bytes: Bytes, purpose: &'static str) -> Result<(), BudgetError> {
        let mut more = self.budget.reserve(Bytes(bytes.0.saturating_sub(self.bytes)), purpose)?;
        // The two become one, and nothing is given back.
        self.bytes += std::mem::take(&mut more.bytes);
        Ok(())
    }

    /// Gives back what is beyond `bytes`.
    pub(crate) fn shrink(&mut self, bytes: Bytes) {
        let given = self.bytes.saturating_sub(bytes.0);
        self.bytes -= given;
        drop(Reservation { budget: self.budget.clone(), bytes: given });
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.shared.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// Bytes set aside for what comes to be known piece by piece while others hold the rest of the budget, and what is left of the
/// budget after that.
#[derive(Debug)]
pub(crate) struct Allowance {
    aside: MemoryBudget,
    budget: MemoryBudget,
    _reservation: Reservation,
}

impl Allowance {
    /// Sets `bytes` aside.
    pub fn new(budget: &MemoryBudget, bytes: Bytes, purpose: &'static str) -> Result<Allowance, BudgetError> {
        let reservation = budget.reserve(bytes, purpose)?;
        Ok(Allowance { aside: MemoryBudget::new(bytes), budget: budget.clone(), _reservation: reservation })
    }

    /// Takes `bytes` from what was set aside, or from the budget if that is used up.
    pub fn reserve(&self, bytes: Bytes, purpose: &'static str) -> Result<Reservation, BudgetError> {
        self.aside.reserve(bytes, purpose).or_else(|_| self.budget.reserve(bytes, purpose))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reservations_add_up_and_are_given_back() {
        let budget = MemoryBudget::new(Bytes(100));
        let first = budget.reserve(Bytes(60), "first").unwrap();
        let error = budget.reserve(Bytes(41), "second").unwrap_err();
        assert_eq!((error.needed, error.available), (Bytes(41), Bytes(40)));
        let second = budget.reserve(Bytes(40), "second").unwrap();
        assert_eq!(budget.available(), Bytes(0));
        drop(first);
        assert_eq!((budget.used(), budget.peak()), (Bytes(40), Bytes(100)));
        drop(second);
        assert_eq!(budget.used(), Bytes(0));
        assert!(budget.reserve(Bytes(u64::MAX), "huge").is_err());
    }

    #[test]
    fn an_allowance_is_used_first_and_the_budget_then() {
        let budget = MemoryBudget::new(Bytes(100));
        let allowance = Allowance::new(&budget, Bytes(40), "pieces").unwrap();
        let first = allowance.reserve(Bytes(30), "a piece").unwrap();
        assert_eq!(budget.used(), Bytes(40));
        let second = allowance.reserve(Bytes(30), "a piece").unwrap();
        assert_eq!(budget.used(), Bytes(70));
        assert!(allowance.reserve(Bytes(31), "a piece").is_err());
        drop((first, second));
        assert_eq!(budget.used(), Bytes(40));
        drop(allowance);
        assert_eq!(budget.used(), Bytes(0));
    }
}
