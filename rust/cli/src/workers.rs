//! The program's threads, lent to the library: rayon's pool, one thread a processor or as many as `RAYON_NUM_THREADS` says.

use boxline::Workers;

/// Rayon's pool.
pub struct Pool;

impl Workers for Pool {
    fn both(&self, first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
        rayon::join(first, second);
    }
}
