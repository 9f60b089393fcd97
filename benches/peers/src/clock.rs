//! CPU time, and what to make of several measurements.

/// CPU seconds of this thread so far.
pub fn thread_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call writes one timespec to where the pointer says.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    assert_eq!(status, 0, "this system measures no CPU time per thread");
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// CPU seconds that `work` takes on this thread.
pub fn measure(work: impl FnOnce()) -> f64 {
    let start = thread_seconds();
    work();
    thread_seconds() - start
}

/// The middle one; of an even number, the mean of the two in the middle.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() % 2 {
        0 if values.is_empty() => f64::NAN,
        0 => 0.5 * (values[middle - 1] + values[middle]),
        _ => values[middle],
    }
}
