//! Measures the duration of work, by the clock or in this thread's processor time, which is
//! independent of other load on the machine.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

pub(crate) fn add_processor_time<T>(secs: &mut f64, work: impl FnOnce() -> T) -> T {
    let before = processor_secs();
    let done = work();
    *secs += (processor_secs() - before).max(0.0);
    done
}

pub(crate) fn add_elapsed_time<T>(secs: &mut f64, work: impl FnOnce() -> T) -> T {
    let before = Instant::now();
    let done = work();
    *secs += before.elapsed().as_secs_f64();
    done
}

fn processor_secs() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use std::thread::sleep;
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_thread_that_sleeps_takes_time_and_no_processor_time() {
        let (mut busy, mut passed) = (0.0, 0.0);
        let done = add_elapsed_time(&mut passed, || {
            add_processor_time(&mut busy, || sleep(Duration::from_millis(60)));
            7
        });
        assert_eq!(done, 7);
        assert!(passed >= 0.06 && busy < 0.03, "{passed} s, {busy} s");
    }

    #[test]
    fn durations_accumulate() {
        let mut busy = 5.0;
        let until = Instant::now() + Duration::from_millis(200);
        add_processor_time(&mut busy, || while Instant::now() < until {});
        // A spinning thread gets processor time even if many others want the core.
        assert!(busy > 5.005, "{busy} s");
        assert!(busy < 5.3, "{busy} s");
    }
}
