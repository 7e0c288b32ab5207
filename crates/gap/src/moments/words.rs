//! Moments in words.

use super::Moment;
use crate::drift::words::numbers;
use crate::report::significant;

/// All moments, one after the other.
pub(crate) fn list(moments: &[Moment], words: fn(&Moment) -> String) -> String {
    moments.iter().map(words).collect::<Vec<_>>().join("; ")
}

/// `payload changed at 17.3 s`.
pub(crate) fn short(m: &Moment) -> String {
    match m.between_logs {
        true => format!("{} changed before {}", m.id, m.log),
        false => format!("{} changed at {} s", m.id, significant(m.at_s, 3)),
    }
}

/// A moment with its interval, and its parameters before and after.
pub(crate) fn sentence(m: &Moment) -> String {
    let when = match m.between_logs {
        true => format!("before {}", m.log),
        false => {
            format!("at {:.2} s of {} ({:.2} to {:.2} s)", m.at_s, m.log, m.interval_s[0], m.interval_s[1])
        }
    };
    let or = match m.look_alikes.is_empty() {
        true => String::new(),
        false => format!(", or {},", m.look_alikes.join(" or ")),
    };
    format!("{}{or} changed {when}: {}", m.id, numbers(&m.parameters, false).join(", "))
}
