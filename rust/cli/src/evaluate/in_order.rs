//! Work on many things at once, results in the order of the things: what has been written so far is then the same whenever it stops.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

/// Does `work` on every job with one thread a processor, or as many as `RAYON_NUM_THREADS` says. Each thread has what `worker` makes,
/// for example a network of its own. `take` gets the results on the calling thread, in the order of the jobs. Jobs are begun in this
/// order too, so only as many results wait for an earlier one as there are threads.
///
/// # Errors
/// The first of `worker` or `take`; what is under way then is finished and dropped.
pub fn in_order<J: Sync, W, R: Send>(
    jobs: &[J],
    worker: impl Fn() -> anyhow::Result<W> + Sync,
    work: impl Fn(&mut W, &J) -> R + Sync,
    mut take: impl FnMut(&J, R) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let next = AtomicUsize::new(0);
    let (send, receive) = mpsc::channel();
    let run = |send: mpsc::Sender<anyhow::Result<(usize, R)>>| {
        let mut own = match worker() {
            Ok(own) => own,
            Err(e) => return drop(send.send(Err(e))),
        };
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(index) else { return };
            if send.send(Ok((index, work(&mut own, job)))).is_err() {
                return; // nobody wants it any more
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(jobs.len()) {
            let send = send.clone();
            scope.spawn(|| run(send));
        }
        drop(send);
        let (mut early, mut due) = (BTreeMap::new(), 0);
        for result in receive {
            let (index, result) = result?;
            early.insert(index, result);
            while let Some(result) = early.remove(&due) {
                take(&jobs[due], result)?;
                due += 1;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn results_come_in_the_order_of_the_jobs() {
        let jobs: Vec<u64> = (0..40).collect();
        let mut taken = Vec::new();
        let work = |done: &mut u64, job: &u64| {
            std::thread::sleep(Duration::from_millis(job * 7 % 5));
            *done += 1;
            (job * job, *done)
        };
        in_order(
            &jobs,
            || Ok(0),
            work,
            |job, (square, _)| {
                assert_eq!(square, job * job);
                taken.push(*job);
                Ok(())
            },
        )
        .unwrap();
        assert_eq!(taken, jobs);
    }

    #[test]
    fn it_stops_at_an_error() {
        let jobs: Vec<u64> = (0..1000).collect();
        let mut taken = 0;
        let stopped = in_order(
            &jobs,
            || Ok(()),
            |(), job| *job,
            |_, job| {
                taken += 1;
                anyhow::ensure!(job < 5, "enough");
                Ok(())
            },
        );
        assert_eq!((stopped.unwrap_err().to_string().as_str(), taken), ("enough", 6));
        let no_worker =
            in_order(&jobs, || Err::<(), _>(anyhow::anyhow!("no network")), |(), _| (), |_, ()| Ok(()));
        assert_eq!(no_worker.unwrap_err().to_string(), "no network");
    }
}
