//! Moments in words.

use super::Moment;
use crate::drift::changes::ChangedParameter;
use crate::report::quantity::{interval, quantity};
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
    format!("{}{or} changed {when}: {}", m.id, numbers(m).join(", "))
}

/// Parameters with the values before and after, 95 % intervals; those that hardly move are left out.
pub(crate) fn numbers(m: &Moment) -> Vec<String> {
    let size = |p: &ChangedParameter| {
        (p.after - p.before).abs() / p.before_sigma.max(p.after_sigma).max(f64::MIN_POSITIVE)
    };
    let most = m.parameters.iter().map(size).fold(0.0, f64::max);
    let one = |p: &ChangedParameter| {
        let values = [(p.before, p.before_sigma), (p.after, p.after_sigma)];
        let [before, after] = values.map(|(value, sigma)| interval(value, sigma, &p.unit));
        let absolute = p.of.as_ref().map_or_else(String::new, |(of, unit)| {
            let [before, after] = values.map(|v| quantity(v.0 * of, unit, 3));
            format!(" ({before} → {after})")
        });
        format!("{} {before} → {after}{absolute}", p.name)
    };
    m.parameters.iter().filter(|p| size(p) > 0.25 * most).map(one).collect()
}
