//! What Linux says of this process.

/// A number of `/proc/self/<file>` after a name.
pub fn proc_number(file: &str, name: &str) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/self/{file}")).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default();
    line.split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(f64::NAN)
}

/// Time on the processor so far, ms.
pub fn processor_ms() -> f64 {
    std::thread::yield_now(); // the kernel counts when it switches
    proc_number("schedstat", "") * 1e-6
}
