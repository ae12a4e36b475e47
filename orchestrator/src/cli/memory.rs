//! Peak memory of this process, part by part (Linux; elsewhere nothing is known).

use std::fs;

use serde_json::{Map, Value, json};

/// Largest resident memory (bytes) of the parts of a run, by name. The programs that pack units are not in it.
#[derive(Default)]
pub(crate) struct Peaks(Vec<(&'static str, u64)>);

impl Peaks {
    /// Ends a part.
    pub(crate) fn take(&mut self, part: &'static str) {
        if let Some(bytes) = peak() {
            self.0.push((part, bytes));
        }
        // Makes the system forget the peak (man 5 proc). Where it may not, each part has the largest of all up to then.
        let _ = fs::write("/proc/self/clear_refs", "5");
    }

    /// That of all.
    pub(crate) fn largest(&self) -> Option<u64> {
        self.0.iter().map(|part| part.1).max()
    }

    pub(crate) fn of_parts(&self) -> Map<String, Value> {
        self.0.iter().map(|&(name, bytes)| (name.to_owned(), json!(bytes))).collect()
    }
}

fn peak() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}
