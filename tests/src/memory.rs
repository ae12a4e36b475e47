//! Resident memory of processes (Linux; 0 elsewhere).

use std::process::{Child, ExitStatus};
use std::time::Duration;

/// A line of a process's status in bytes; 0 where there is none.
fn status(process: &str, key: &str) -> usize {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with(key)).unwrap_or_default();
    1024 * line.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0)
}

/// Resident memory of this process (bytes).
pub fn resident() -> usize {
    status("self", "VmRSS")
}

/// Largest resident memory of this process up to now (bytes).
pub fn peak() -> usize {
    status("self", "VmHWM")
}

/// What `act` makes, and the largest resident memory of this process (bytes) in it.
///
/// # Errors
/// Where the system does not forget the peak before it.
pub fn peak_of<T>(act: impl FnOnce() -> T) -> std::io::Result<(T, usize)> {
    forget_peak()?;
    let result = act();
    Ok((result, peak()))
}

/// Makes the system forget the peak (man 5 proc).
///
/// # Errors
/// Where it does not.
pub fn forget_peak() -> std::io::Result<()> {
    std::fs::write("/proc/self/clear_refs", "5")
}

/// Waits for a child, and gives its largest resident memory (bytes), looked at every millisecond.
///
/// # Errors
/// Of the system.
pub fn watch(child: &mut Child) -> std::io::Result<(ExitStatus, usize)> {
    let (process, mut largest) = (child.id().to_string(), 0);
    loop {
        largest = largest.max(status(&process, "VmHWM"));
        if let Some(status) = child.try_wait()? {
            return Ok((status, largest));
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}
