//! Where something stays unexplained, what is written must help clearly in every part of the held-out flight.
//!
//! A fit without the right effect gives part of what is missing to the effects that it has, as far as both go together in
//! this flight. Over the whole flight such a finding may lower the errors; where it does not in a part of it, it follows the
//! manoeuvre and not the vehicle, and the next flight is another manoeuvre.

use super::Writer;
use crate::error::Result;
use crate::headline::pair;
use crate::judge::{Judge, Risen, Seen};
use crate::policy::{RISES, WELL_BELOW};
use crate::report::significant;
use crate::verdict::{Calibration, Finding, HeldOut};
use rayon::prelude::*;

/// Drops findings, the one without which the vehicle is best first, until in every part of the flight no error rises and all
/// errors together fall to [`WELL_BELOW`]; what was to be written together with them goes with the first. Returns the findings
/// that stay.
///
/// # Errors
/// If the text is not a valid vehicle file.
pub(super) fn judged(
    writer: &Writer,
    judge: &Judge,
    findings: &mut [Finding],
    mut kept: Vec<usize>,
    adjusted: &mut [Calibration],
) -> Result<Vec<usize>> {
    // Nothing can rise above a nominal vehicle that never stays finite.
    let Ok(filed) = judge.in_parts(writer.filed.vehicle) else { return Ok(kept) };
    while !kept.is_empty() {
        let mut with = writer.clone();
        with.partners.extend(adjusted.iter().filter(|c| c.partner).cloned());
        let Some(worst) = worst_part(judge, &with, findings, &kept, &filed)? else { return Ok(kept) };
        if worst.fine() {
            return Ok(kept);
        }
        let without = |index: &usize| -> Result<(f64, usize)> {
            let rest: Vec<usize> = kept.iter().copied().filter(|k| k != index).collect();
            let left = worst_part(judge, writer, findings, &rest, &filed)?;
            Ok((left.map_or(f64::INFINITY, |w| w.together.max(w.most.ratio)), *index))
        };
        let tried: Vec<(f64, usize)> = kept.par_iter().map(without).collect::<Result<_>>()?;
        let Some((_, out)) = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        let f = &mut findings[out];
        f.certain = false;
        if let Some(told) = f.held_out.take() {
            f.held_out = Some(HeldOut { written: false, doubt: Some(worst.words(judge)), ..told });
        }
        kept.retain(|index| *index != out);
        adjusted.iter_mut().for_each(|c| c.partner = false);
    }
    Ok(kept)
}

/// The worst over the parts of the flight.
struct Worst {
    /// The error that rises most.
    most: Risen,
    /// All errors together over those of the file, where they fall least.
    together: f64,
}

impl Worst {
    fn fine(&self) -> bool {
        self.most.ratio <= RISES && self.together <= WELL_BELOW
    }

    fn words(&self, judge: &Judge) -> String {
        let Self { most, together } = self;
        let what = if most.ratio > RISES {
            format!(
                "the {} error is {} times that of the file with it ({})",
                most.channel,
                significant(most.ratio, 3),
                pair(most.filed, most.now, most.unit)
            )
        } else {
            format!("all errors together are {} times those of the file with it", significant(*together, 3))
        };
        format!("something is unexplained, and in a part of {} {what}: not written", judge.title())
    }
}

/// The worst over all parts of the vehicle with the findings `kept`; `None` where it diverges.
fn worst_part(
    judge: &Judge,
    writer: &Writer,
    findings: &[Finding],
    kept: &[usize],
    filed: &[Seen],
) -> Result<Option<Worst>> {
    let Ok(parts) = judge.in_parts(&writer.with(findings, kept)?) else { return Ok(None) };
    let each = parts.iter().zip(filed);
    let together = each.clone().map(|(now, filed)| now.over(filed)).fold(0.0, f64::max);
    let risen = each.map(|(now, filed)| now.most_risen(filed));
    let most = risen.max_by(|a, b| a.ratio.total_cmp(&b.ratio));
    Ok(most.map(|most| Worst { most, together }))
}
