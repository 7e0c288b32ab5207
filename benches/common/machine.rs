//! The machine that a benchmark runs on. Linux says all of it in `/proc`; elsewhere some of it is not known.

use std::process::Command;

use super::Fallible;

/// Name of the processor.
pub fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(": "));
    model.map_or_else(|| std::env::consts::ARCH.into(), |(_, name)| name.trim().to_string())
}

/// Cores that this process may use.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Processes that wait to run, averaged over 1, 5 and 15 minutes.
pub fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().take(3).collect::<Vec<_>>().join(" ")
}

/// The cores that this process may use, as `taskset` writes them.
pub fn allowed() -> Fallible<String> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let list =
        text.lines().find_map(|l| l.strip_prefix("Cpus_allowed_list:")).ok_or("no Cpus_allowed_list")?;
    Ok(list.trim().to_string())
}

/// The last of those cores.
pub fn last_core() -> Fallible<String> {
    Ok(allowed()?.rsplit([',', '-']).next().unwrap_or("0").to_string())
}

/// Keeps this process, and what it starts from now on, on some cores (`3`, `0-1`).
pub fn pin(cores: &str) -> Fallible<()> {
    let id = std::process::id().to_string();
    let mut said = String::new();
    // Threads of a pool that was just dropped may end while it looks at them.
    for _ in 0..5 {
        let out = Command::new("taskset")
            .args(["--all-tasks", "--cpu-list", "--pid", cores, &id])
            .output()
            .map_err(|e| format!("`taskset` could not be started: {e}; install util-linux"))?;
        if out.status.success() {
            return Ok(());
        }
        said = String::from_utf8_lossy(&out.stderr).trim().to_string();
        if !said.contains("No such process") {
            break;
        }
    }
    Err(format!("taskset to cores {cores} failed: {said}").into())
}

/// A figure of `/proc/ID/status` in kB, as MiB: VmHWM is the most memory that the process had in use, VmRSS what it has now.
pub fn memory_mib(process: u32, name: &str) -> Fallible<f64> {
    let text = std::fs::read_to_string(format!("/proc/{process}/status"))?;
    let line = text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(':'));
    let kb = line.ok_or_else(|| format!("no {name} in /proc"))?.trim().trim_end_matches("kB");
    Ok(kb.trim().parse::<f64>()? / 1024.0)
}

/// Memory that programs could still have, MiB.
pub fn available_mib() -> Fallible<f64> {
    let text = std::fs::read_to_string("/proc/meminfo")?;
    let line =
        text.lines().find_map(|l| l.strip_prefix("MemAvailable:")).ok_or("no MemAvailable in /proc")?;
    Ok(line.trim().trim_end_matches("kB").trim().parse::<f64>()? / 1024.0)
}

/// Version of the compiler that cargo uses.
pub fn compiler() -> String {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let out = Command::new(rustc).arg("--version").output();
    out.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_string()).unwrap_or_default()
}

/// Today in UTC, as 2026-01-31.
pub fn today() -> String {
    let days = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |since| since.as_secs() / 86400);
    // Years that begin in March: the leap day is the last of its year.
    let mut left = days + 719_468;
    let era = left / 146_097;
    left %= 146_097;
    let year = (left - left / 1460 + left / 36_524 - left / 146_096) / 365;
    let day_of_year = left - (365 * year + year / 4 - year / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * era + u64::from(month <= 2);
    format!("{year}-{month:02}-{day:02}")
}
