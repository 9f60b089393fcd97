//! Lists of slots in order of age, several in one piece of memory.

/// Doubly linked lists through the slots, each closed to a ring by a link of its own: a slot is in at most one of them,
/// and moving it is a few writes.
#[derive(Debug, Default)]
pub(super) struct Rings {
    /// One link per slot, then one per list. `newer` of a list's own link is its oldest slot, `older` its newest.
    links: Vec<Link>,
    slot_count: u32,
}

#[derive(Clone, Copy, Debug)]
struct Link {
    older: u32,
    newer: u32,
}

impl Rings {
    /// Bytes for each slot; the lists' own links are a handful beside them.
    pub const BYTES_PER_SLOT: u64 = size_of::<Link>() as u64;

    /// So many empty lists.
    pub fn new(slot_count: u32, list_count: u32) -> Rings {
        // A link to itself: in no list.
        let links =
            (0..slot_count.saturating_add(list_count)).map(|at| Link { older: at, newer: at }).collect();
        Rings { links, slot_count }
    }

    /// Index of the link that closes `list`.
    fn end(&self, list: u32) -> u32 {
        self.slot_count + list
    }

    /// Whether `slot` is in any list.
    pub fn contains(&self, slot: u32) -> bool {
        self.links[slot as usize].newer != slot
    }

    /// Takes `slot` out of its list, if it is in one.
    pub fn remove(&mut self, slot: u32) {
        let Link { older, newer } = self.links[slot as usize];
        self.links[older as usize].newer = newer;
        self.links[newer as usize].older = older;
        self.links[slot as usize] = Link { older: slot, newer: slot };
    }

    /// Puts `slot`, which is in no list, at the new end of `list`.
    pub fn push(&mut self, list: u32, slot: u32) {
        let end = self.end(list);
        let newest = self.links[end as usize].older;
        self.links[slot as usize] = Link { older: newest, newer: end };
        self.links[newest as usize].newer = slot;
        self.links[end as usize].older = slot;
    }

    /// The slot at the old end of `list`.
    pub fn oldest(&self, list: u32) -> Option<u32> {
        self.iter(list).next()
    }

    /// The slots of `list`, oldest first.
    pub fn iter(&self, list: u32) -> impl Iterator<Item = u32> + '_ {
        let end = self.end(list);
        let newer = |at: u32| self.links.get(at as usize).map(|link| link.newer);
        std::iter::successors(newer(end), move |slot| newer(*slot)).take_while(move |slot| *slot != end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_share_slots_but_not_members() {
        let mut rings = Rings::new(4, 2);
        assert_eq!((rings.oldest(0), rings.oldest(1)), (None, None));
        for (list, slot) in [(0, 2), (1, 0), (0, 3), (0, 1)] {
            rings.push(list, slot);
        }
        assert_eq!(rings.iter(0).collect::<Vec<_>>(), [2, 3, 1]);
        rings.remove(3);
        assert!(!rings.contains(3) && rings.contains(0));
        rings.remove(3);
        rings.push(1, 3);
        assert_eq!(rings.iter(0).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(rings.iter(1).collect::<Vec<_>>(), [0, 3]);
        assert_eq!(Rings::new(0, 1).oldest(0), None);
        assert_eq!(Rings::default().oldest(0), None);
    }
}
