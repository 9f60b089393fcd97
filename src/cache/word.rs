//! What the table knows about one block, in 64 bits.

/// The state of one block. Bit fields, from the low end:
///
/// | bits | field | meaning |
/// |---|---|---|
/// | 0 ..= 31 | slot | where the block is or will be; 0 when absent |
/// | 32 ..= 61 | pins | how many [`Pin`](super::Pin)s of it live; 0 unless ready |
/// | 62 ..= 63 | phase | 0 absent, 1 loading, 2 ready; 3 never |
///
/// Transitions; those marked L happen under the table's lock, one at a time:
///
/// | | from | to | who |
/// |---|---|---|---|
/// | T1 L | absent | loading, slot | the thread that will fill |
/// | T2 L | loading | ready, 1 pin | the same thread, when the slot is filled |
/// | T3 L | loading | absent | the same thread, when filling failed or panicked |
/// | T4 | ready, n pins | ready, n + 1 pins | any thread: a hit |
/// | T5 | ready, n + 1 pins | ready, n pins | the owner of a pin |
/// | T6 L | ready, 0 pins | absent | a thread that needs the slot |
///
/// T4 and T5 need no lock and race with each other and with T6. A pin holds off T6, and a word that is not ready
/// refuses T4.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Word(pub(super) u64);

/// Where a block is on its way in or out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    Absent,
    Loading,
    Ready,
}

const PINS_SHIFT: u32 = 32;
const PINS_MASK: u64 = (1 << 30) - 1;
const PHASE_SHIFT: u32 = 62;
const LOADING: u64 = 1;
const READY: u64 = 2;

impl Word {
    pub(super) const ABSENT: Word = Word(0);
    /// What T5 subtracts and T4 adds.
    pub(super) const ONE_PIN: u64 = 1 << PINS_SHIFT;
    /// Pins beyond this are refused: the next one would run into the phase.
    pub(super) const PINS_MAX: u64 = PINS_MASK;

    pub(super) fn loading(slot: u32) -> Word {
        Word(LOADING << PHASE_SHIFT | u64::from(slot))
    }

    pub(super) fn ready(slot: u32, pins: u64) -> Word {
        debug_assert!(pins <= Self::PINS_MAX);
        Word(READY << PHASE_SHIFT | pins << PINS_SHIFT | u64::from(slot))
    }

    pub(super) fn phase(self) -> Phase {
        match self.0 >> PHASE_SHIFT {
            0 => Phase::Absent,
            LOADING => Phase::Loading,
            _ => Phase::Ready,
        }
    }

    pub(super) fn pins(self) -> u64 {
        self.0 >> PINS_SHIFT & PINS_MASK
    }

    pub(super) fn slot(self) -> u32 {
        self.0 as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_do_not_overlap() {
        let full = Word::ready(u32::MAX, Word::PINS_MAX);
        assert_eq!((full.phase(), full.pins(), full.slot()), (Phase::Ready, Word::PINS_MAX, u32::MAX));
        let one = Word(Word::ready(7, 0).0 + Word::ONE_PIN);
        assert_eq!((one.phase(), one.pins(), one.slot()), (Phase::Ready, 1, 7));
        let loading = Word::loading(u32::MAX);
        assert_eq!((loading.phase(), loading.pins(), loading.slot()), (Phase::Loading, 0, u32::MAX));
        assert_eq!((Word::ABSENT.phase(), Word::ABSENT.pins()), (Phase::Absent, 0));
    }
}
