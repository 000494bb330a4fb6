//! Numbers that stand for native objects on the Java side.
//!
//! A handle is not a pointer: it is looked up, so a wrong one is found out instead of followed. Numbers start at 1 and are
//! never used twice, so a closed handle stays closed. A lookup gives its own `Arc`: closing during a call is safe, the
//! object goes with the last call.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Which handle is not open, and whether it ever was.
#[derive(Debug)]
pub(crate) struct NotOpen(pub String);

/// The open objects of one type.
pub(crate) struct Handles<T>(Mutex<Table<T>>);

struct Table<T> {
    last: i64,
    open: BTreeMap<i64, Arc<T>>,
}

impl<T> Handles<T> {
    pub const fn new() -> Self {
        Self(Mutex::new(Table { last: 0, open: BTreeMap::new() }))
    }

    // Nothing inside can be left half done by a panic, so a poisoned lock is as good as any.
    fn table(&self) -> MutexGuard<'_, Table<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps an object and gives its handle.
    pub fn open(&self, object: T) -> i64 {
        let mut table = self.table();
        table.last += 1;
        let handle = table.last;
        table.open.insert(handle, Arc::new(object));
        handle
    }

    /// The object of a handle. The error says whether it was closed or never opened.
    pub fn get(&self, handle: i64) -> Result<Arc<T>, NotOpen> {
        let table = self.table();
        table.open.get(&handle).cloned().ok_or_else(|| {
            let state = if table.knows(handle) { "is closed" } else { "was never opened" };
            NotOpen(format!("handle {handle} {state}"))
        })
    }

    /// Lets go of an object. A handle that is closed already stays closed: that is no error.
    pub fn close(&self, handle: i64) -> Result<(), NotOpen> {
        let mut table = self.table();
        if !table.knows(handle) {
            return Err(NotOpen(format!("handle {handle} was never opened")));
        }
        let closed = table.open.remove(&handle);
        drop(table); // the object's own clean-up must not hold up the others
        drop(closed);
        Ok(())
    }

    /// How many objects are open.
    #[cfg(any(test, feature = "testing"))]
    pub fn count(&self) -> usize {
        self.table().open.len()
    }
}

impl<T> Table<T> {
    fn knows(&self, handle: i64) -> bool {
        (1..=self.last).contains(&handle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_handle_stays_closed() {
        let handles = Handles::new();
        let first = handles.open("first");
        let second = handles.open("second");
        assert_eq!(*handles.get(first).unwrap(), "first");
        handles.close(first).unwrap();
        assert_eq!(handles.get(first).unwrap_err().0, "handle 1 is closed");
        handles.close(first).unwrap();
        assert_ne!(handles.open("third"), first, "numbers are not used twice");
        assert_eq!(*handles.get(second).unwrap(), "second");
    }

    #[test]
    fn a_handle_that_never_was_is_an_error() {
        let handles = Handles::new();
        handles.open(());
        for handle in [0, -1, 2, i64::MAX, i64::MIN] {
            assert_eq!(handles.get(handle).unwrap_err().0, format!("handle {handle} was never opened"));
            assert_eq!(handles.close(handle).unwrap_err().0, format!("handle {handle} was never opened"));
        }
        assert_eq!(handles.count(), 1);
    }

    #[test]
    fn closing_during_a_call_leaves_the_object_to_the_call() {
        let handles = Handles::new();
        let handle = handles.open(vec![1, 2, 3]);
        let in_use = handles.get(handle).unwrap();
        handles.close(handle).unwrap();
        assert_eq!((handles.count(), in_use.len()), (0, 3));
    }
}
