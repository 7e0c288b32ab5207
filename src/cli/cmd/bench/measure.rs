//! Timing of calls, and what the system says of this process.

use crate::Result;
use std::time::Instant;

/// Fewest calls that a row counts.
const LEAST_CALLS: usize = 3;

/// A rate, per second: median, and what 5 % and 95 % of the calls stay below.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Rate {
    /// Half of the calls are faster.
    pub median: f64,
    /// 5 % of the calls are slower.
    pub low: f64,
    /// 5 % of the calls are faster.
    pub high: f64,
    /// Calls that were counted.
    pub calls: usize,
}

/// Rate of calls that each do `amount`: `call` returns the seconds that count and is repeated for `seconds`, after one call
/// that is left out.
pub fn rate(seconds: f64, amount: f64, mut call: impl FnMut() -> Result<f64>) -> Result<Rate> {
    call()?;
    let begin = Instant::now();
    let mut times = Vec::new();
    while times.len() < LEAST_CALLS || begin.elapsed().as_secs_f64() < seconds {
        times.push(call()?);
    }
    times.sort_by(f64::total_cmp);
    // A clock that does not tick within a call would divide by zero.
    let at = |share: f64| amount / times[((times.len() - 1) as f64 * share).round() as usize].max(1e-9);
    Ok(Rate { median: at(0.5), low: at(0.95), high: at(0.05), calls: times.len() })
}

/// Seconds of a call.
pub fn seconds(call: impl FnOnce() -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    call()?;
    Ok(start.elapsed().as_secs_f64())
}

/// Most memory that this process had in use so far, MiB; none where the system does not say so.
pub fn peak_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<f64>().ok()? / 1024.0)
}

/// Name of the processor.
pub fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(": "));
    model.map_or_else(|| std::env::consts::ARCH.into(), |(_, name)| name.trim().to_string())
}

/// Processes that wait to run, averaged over 1, 5 and 15 minutes; none where the system does not say so.
pub fn load() -> Option<String> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    Some(text.split_whitespace().take(3).collect::<Vec<_>>().join(" "))
}

/// A number with three figures and a letter for thousands, millions and more: `12.3 k`.
pub fn figure(v: f64) -> String {
    let (scaled, letter) = match v.abs() {
        a if a >= 999.5e6 => (v / 1e9, " G"),
        a if a >= 999.5e3 => (v / 1e6, " M"),
        a if a >= 9_995.0 => (v / 1e3, " k"),
        _ => (v, ""),
    };
    let digits = match scaled.abs() {
        a if a >= 99.95 => 0,
        a if a >= 9.995 => 1,
        _ => 2,
    };
    format!("{scaled:.digits$}{letter}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_that_of_the_middle_call() {
        // The first is left out.
        let mut times = [9.0, 1.0, 0.25, 0.5].into_iter();
        let r = rate(1e-9, 10.0, || Ok(times.next().unwrap_or(f64::NAN))).unwrap();
        assert_eq!((r.median, r.low, r.high, r.calls), (20.0, 10.0, 40.0, 3));
    }

    #[test]
    fn figures_have_three_digits() {
        let shown = [0.1234, 5.678, 99.96, 1234.0, 9_999.0, 157.66e6, 999.9e6].map(figure);
        assert_eq!(shown, ["0.12", "5.68", "100", "1234", "10.0 k", "158 M", "1.00 G"]);
    }
}
