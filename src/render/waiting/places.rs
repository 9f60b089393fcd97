//! A fixed number of places, each free or taken by something.

/// Nothing: no place, the end of a list.
pub(super) const NONE: u32 = u32::MAX;

/// See the module's text. What is taken out last is filled first, so that memory in use stays together.
pub(super) struct Places<T> {
    things: Vec<T>,
    free: Vec<u32>,
    capacity: u32,
}

impl<T> Places<T> {
    pub fn new(capacity: u32) -> Places<T> {
        Places {
            things: Vec::with_capacity(capacity as usize),
            free: Vec::with_capacity(capacity as usize),
            capacity,
        }
    }

    /// What [`Places::new`] allocates for each.
    pub const BYTES_OF_ONE: usize = size_of::<T>() + size_of::<u32>();

    /// How many are taken.
    pub fn count(&self) -> u32 {
        (self.things.len() - self.free.len()) as u32
    }

    /// How many are free.
    pub fn room(&self) -> u32 {
        self.capacity - self.count()
    }

    /// Puts a thing into a place. Who calls it has made sure that there is room.
    pub fn add(&mut self, thing: T) -> u32 {
        match self.free.pop() {
            Some(place) => {
                self.things[place as usize] = thing;
                place
            }
            None => {
                debug_assert!(self.things.len() < self.capacity as usize);
                self.things.push(thing);
                self.things.len() as u32 - 1
            }
        }
    }

    /// Gives back a place that is taken.
    pub fn remove(&mut self, place: u32) {
        self.free.push(place);
    }

    pub fn get(&self, place: u32) -> &T {
        &self.things[place as usize]
    }

    pub fn get_mut(&mut self, place: u32) -> &mut T {
        &mut self.things[place as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_taken_and_given_back() {
        let mut places = Places::new(3);
        let [a, b] = ['a', 'b'].map(|thing| places.add(thing));
        assert_eq!((places.count(), places.room()), (2, 1));
        places.remove(a);
        assert_eq!((places.count(), places.room()), (1, 2));
        assert_eq!((places.add('c'), places.add('d')), (a, 2));
        *places.get_mut(b) = 'e';
        assert_eq!([a, b, 2].map(|place| *places.get(place)), ['c', 'e', 'd']);
        assert_eq!(places.room(), 0);
    }
}
