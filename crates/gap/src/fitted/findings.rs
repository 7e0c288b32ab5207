//! Judges findings on held-out flight: what makes the vehicle worse there is not written, but reported as doubtful with
//! both numbers.
//!
//! Three rules, applied in this order, each until it holds:
//!
//! 1. A finding that makes its own channel *and* the roll-outs worse, comparing the vehicle with all findings to the one
//!    without it, is dropped; the worst first.
//! 2. The vehicle with all remaining findings may not be worse than the nominal one, over all channels together and in the
//!    own channel of any finding. Otherwise the finding without which it is best is dropped.
//! 3. Where effects were searched for, a finding that lowers neither its own channel nor all errors together to
//!    [`LITTLE_GAIN`] is dropped. Formulas have a judgement of their own, beside calibration, unless the second estimator denies them.

use super::Writer;
use crate::complete::group;
use crate::error::Result;
use crate::headline::pair;
use crate::judge::{Judge, Part, Seen};
use crate::policy::{CLOCKS_OFF_S, LITTLE_GAIN, WORSE};
use crate::report::significant;
use crate::verdict::{Finding, HeldOut, Said};
use propwash_physics::effects::Group;
use rayon::prelude::*;

/// A finding judged beside all others.
pub(super) struct Tried {
    pub index: usize,
    pub without: Seen,
    pub part: Part,
    pub held_out: HeldOut,
}

impl Tried {
    /// How much worse the finding makes its own channel and the roll-outs.
    fn harm(&self) -> (f64, f64) {
        (self.held_out.with / self.held_out.without, self.held_out.roll_outs)
    }
}

/// Judges the findings `writable`, by index: returns those to write, and records in all of them their effect on the errors.
///
/// # Errors
/// If the text is not a valid vehicle file.
pub(super) fn judged(
    writer: &Writer,
    judge: &Judge,
    findings: &mut [Finding],
    writable: Vec<usize>,
) -> Result<Vec<usize>> {
    if writable.is_empty() {
        return Ok(writable);
    }
    // Nothing can be worse than a nominal vehicle that never stays finite.
    let Ok(filed) = judge.look(writer.filed.vehicle) else { return Ok(writable) };
    let mut kept = writable;
    loop {
        let Some((whole, tried)) = try_all(writer, judge, findings, &kept, &filed)? else {
            // A vehicle that diverges is worse than any: its least evident finding is dropped.
            let last = kept.pop();
            if let Some(index) = last {
                findings[index].held_out = Some(runs_away(judge));
            }
            if kept.is_empty() {
                return Ok(kept);
            }
            continue;
        };
        let harmful = worst(judge, &tried, &whole, &filed);
        let little = harmful.is_none() && !writer.given;
        // A formula that the second estimator denies has to show its gain by itself: of a load that nobody tracked one took 0.2 % off.
        let formula = |t: &Tried| {
            let f = &findings[t.index];
            writer.formulas.contains(&f.id) && f.second.said != Said::Differs
        };
        let out = harmful.or_else(|| little.then(|| least_gain(judge, &tried, &whole, formula)).flatten());
        let Some((at, words)) = out else {
            for t in tried {
                findings[t.index].held_out = Some(whole.clearest(&t.without));
            }
            return Ok(kept);
        };
        let t = &tried[at];
        findings[t.index].held_out =
            Some(HeldOut { written: false, doubt: Some(words), little, ..t.held_out.clone() });
        findings[t.index].certain &= little;
        kept.retain(|index| *index != t.index);
        if kept.is_empty() {
            return Ok(kept);
        }
    }
}

/// Whether a finding is a delay that is not certain and no longer than clocks of sensors are off ([`CLOCKS_OFF_S`]). Where nothing but one
/// log shows it, it may be that log's clocks, which the next flight does not share.
pub(super) fn is_clock_in_doubt(f: &Finding) -> bool {
    let short = f.parameters.iter().all(|p| (p.value - p.filed).abs() <= CLOCKS_OFF_S);
    !f.certain && short && group(&f.kind, f.area) == Group::Clocks
}

/// Says of the delays `clocks` that they are not written, with what they would do beside the findings `kept`.
///
/// # Errors
/// If the text is not a valid vehicle file.
pub(super) fn leave_clocks(
    writer: &Writer,
    judge: &Judge,
    findings: &mut [Finding],
    kept: &[usize],
    clocks: &[usize],
) -> Result<()> {
    if clocks.is_empty() {
        return Ok(());
    }
    let without = judge.look(&writer.with(findings, kept)?);
    for index in clocks {
        let all: Vec<usize> = kept.iter().chain([index]).copied().collect();
        let with = judge.look(&writer.with(findings, &all)?);
        findings[*index].held_out = Some(match (&with, &without) {
            (Ok(with), Ok(without)) => HeldOut {
                written: false,
                little: true,
                doubt: Some(
                    "it is in doubt and may come from the clocks of this one log: give a second flight; not written".into(),
                ),
                ..with.against(without).1
            },
            _ => runs_away(judge),
        });
    }
    Ok(())
}

/// The vehicle with the findings `kept`, and with each of them left out; `None` where the vehicle diverges.
pub(super) fn try_all(
    writer: &Writer,
    judge: &Judge,
    findings: &[Finding],
    kept: &[usize],
    filed: &Seen,
) -> Result<Option<(Seen, Vec<Tried>)>> {
    let Ok(whole) = judge.look(&writer.with(findings, kept)?) else { return Ok(None) };
    let tried = kept
        .par_iter()
        .map(|index| {
            let rest: Vec<usize> = kept.iter().copied().filter(|k| k != index).collect();
            let without = match rest.is_empty() {
                true => filed.clone(),
                // Without it the vehicle diverges: the finding is never worse than that.
                false => match judge.look(&writer.with(findings, &rest)?) {
                    Ok(seen) => seen,
                    Err(_) => whole.clone(),
                },
            };
            let (part, held_out) = whole.against(&without);
            Ok(Tried { index: *index, without, part, held_out })
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(Some((whole, tried)))
}

/// The finding to drop, and why; `None` where all may stay.
fn worst(judge: &Judge, tried: &[Tried], whole: &Seen, filed: &Seen) -> Option<(usize, String)> {
    let own = |t: &Tried| {
        let h = &t.held_out;
        format!(
            "the {} error on {} rises from {}",
            h.channel,
            judge.title(),
            pair(h.without, h.with, &h.unit).replace(" → ", " to ")
        )
    };
    let harmful = (0..tried.len())
        .filter(|i| {
            let (own, rolls) = tried[*i].harm();
            own > WORSE && rolls > WORSE
        })
        .max_by(|a, b| {
            let size = |i: usize| tried[i].harm().0 * tried[i].harm().1;
            size(*a).total_cmp(&size(*b))
        });
    if let Some(i) = harmful {
        let words = format!(
            "{} with it and that of roll-outs by {}: not written",
            own(&tried[i]),
            by(tried[i].held_out.roll_outs)
        );
        return Some((i, words));
    }
    let all = whole.over(filed);
    let risen: Vec<usize> =
        (0..tried.len()).filter(|i| whole.part_over(filed, tried[*i].part) > WORSE).collect();
    if all <= WORSE && risen.is_empty() {
        return None;
    }
    // If a channel has risen, a finding that acts on it; else the one without which the vehicle is best.
    let from: Vec<usize> = if risen.is_empty() { (0..tried.len()).collect() } else { risen };
    let least = from.into_iter().max_by(|a, b| {
        let gain = |i: usize| whole.over(&tried[i].without);
        gain(*a).total_cmp(&gain(*b))
    })?;
    let t = &tried[least];
    let words = if all > WORSE {
        format!(
            "with what was found the errors on {} are {} times those of the file, all channels together, and this \
             finding brings least ({}): not written",
            judge.title(),
            significant(all, 3),
            told(&t.held_out)
        )
    } else {
        format!(
            "the {} error on {} is {} times that of the file with what was found: not written",
            t.held_out.channel,
            judge.title(),
            significant(whole.part_over(filed, t.part), 3)
        )
    };
    Some((least, words))
}

/// The finding that lowers the error least, and why it is dropped; `None` where each lowers it enough, or is a `formula`.
fn least_gain(
    judge: &Judge,
    tried: &[Tried],
    whole: &Seen,
    formula: impl Fn(&Tried) -> bool,
) -> Option<(usize, String)> {
    let left = |t: &Tried| (t.held_out.with / t.held_out.without).min(whole.over(&t.without));
    let (at, t) = tried
        .iter()
        .enumerate()
        .filter(|(_, t)| left(t) > LITTLE_GAIN && !formula(t))
        .max_by(|a, b| left(a.1).total_cmp(&left(b.1)))?;
    let words = format!(
        "it takes too little off the errors on {} ({}), less than flights of one vehicle differ by: not written",
        judge.title(),
        told(&t.held_out)
    );
    Some((at, words))
}

fn told(h: &HeldOut) -> String {
    format!("{} {}", h.channel, pair(h.without, h.with, &h.unit))
}

/// `3.1 %` of a ratio of 1.031.
fn by(ratio: f64) -> String {
    format!("{} %", significant(100.0 * (ratio - 1.0), 2))
}

/// Judgement of a finding with which the vehicle diverges.
pub(super) fn runs_away(judge: &Judge) -> HeldOut {
    HeldOut {
        channel: "position after 0.5 s".into(),
        unit: "m".into(),
        without: 0.0,
        with: f64::INFINITY,
        times_noise: None,
        roll_outs: f64::INFINITY,
        written: false,
        little: false,
        doubt: Some(format!("with it the model does not stay finite on {}: not written", judge.title())),
    }
}
