//! Where something stays unexplained, what is written must help clearly in every part of the held-out flight, and findings must
//! not make up for each other.
//!
//! A fit without the right effect gives part of what is missing to the effects that it has, as far as both go together in
//! this flight. Over the whole flight such a finding may lower the errors; where it does not in a part of it, it follows the
//! manoeuvre and not the vehicle, and the next flight is another manoeuvre.

use super::Writer;
use super::findings::{Tried, try_all};
use super::partners::{doubt, least_missed};
use crate::error::Result;
use crate::headline::pair;
use crate::judge::{Judge, Risen, Seen};
use crate::policy::{MAKES_UP, RISES_IN_PART, WELL_BELOW};
use crate::report::significant;
use crate::verdict::{Calibration, Finding};

/// Drops findings that make up for each other; then more, the one without which the vehicle is best first, until in every part of the
/// flight no error rises and all errors together fall to [`WELL_BELOW`]. What was to be written together with them goes with the
/// first. Returns the findings that stay.
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
    let before = kept.len();
    kept = without_balancing(writer, judge, findings, kept)?;
    if kept.len() < before {
        adjusted.iter_mut().for_each(|c| c.partner = false);
    }
    // Nothing can rise above a nominal vehicle that never stays finite.
    let Ok(filed) = judge.in_parts(writer.filed.vehicle) else { return Ok(kept) };
    while !kept.is_empty() {
        let mut with = writer.clone();
        with.partners.extend(adjusted.iter().filter(|c| c.partner).cloned());
        // A vehicle that diverges was dealt with before.
        let Ok(parts) = judge.in_parts(&with.with(findings, &kept)?) else { return Ok(kept) };
        let Some(found) = wrong(&parts, &filed) else { return Ok(kept) };
        let size = |rest: &[usize]| -> Result<f64> {
            let parts = judge.in_parts(&writer.with(findings, rest)?);
            Ok(parts.map_or(f64::INFINITY, |parts| wrong(&parts, &filed).map_or(0.0, |w| w.size())))
        };
        let Some(out) = least_missed(&kept, size)? else { break };
        doubt(&mut findings[out], found.words(judge));
        kept.retain(|index| *index != out);
        adjusted.iter_mut().for_each(|c| c.partner = false);
    }
    Ok(kept)
}

/// Drops findings that make up for each other: without any of them alone, the error of the channel on which it acts is
/// [`MAKES_UP`] times that of the file. Large terms whose sum is small fit what no listed effect describes, and neither is real.
fn without_balancing(
    writer: &Writer,
    judge: &Judge,
    findings: &mut [Finding],
    kept: Vec<usize>,
) -> Result<Vec<usize>> {
    // What diverges was dealt with before.
    let Ok(filed) = judge.look(writer.filed.vehicle) else { return Ok(kept) };
    let Some((_, tried)) = try_all(writer, judge, findings, &kept, &filed)? else { return Ok(kept) };
    let times = |t: Tried| (t.index, t.without.part_over(&filed, t.part), t.held_out.channel);
    let balancing: Vec<(usize, f64, String)> =
        tried.into_iter().map(times).filter(|(_, times, _)| *times > MAKES_UP).collect();
    if balancing.len() < 2 {
        return Ok(kept);
    }
    for (index, times, channel) in &balancing {
        let others = balancing.iter().filter(|(other, ..)| other != index);
        let others: Vec<&str> = others.map(|(other, ..)| findings[*other].id.as_str()).collect();
        let words = format!(
            "something is unexplained, and it and {} make up for each other: without it alone the {} error on {} is {} \
             times that of the file: not written",
            others.join(", "),
            channel,
            judge.title(),
            significant(*times, 3)
        );
        doubt(&mut findings[*index], words);
    }
    Ok(kept.into_iter().filter(|k| balancing.iter().all(|(index, ..)| index != k)).collect())
}

/// What is wrong with a vehicle in a part of a flight; `None` where it helps clearly in all of them.
fn wrong(parts: &[Seen], filed: &[Seen]) -> Option<Wrong> {
    let judged = || parts.iter().zip(filed).filter(|(now, filed)| !now.blind() && !filed.blind());
    let risen = judged().map(|(now, filed)| now.most_risen(filed));
    // Without a part that is long enough nothing can be said against the vehicle.
    let most = risen.max_by(|a, b| a.ratio.total_cmp(&b.ratio))?;
    let together = judged().map(|(now, filed)| now.over(filed)).fold(0.0, f64::max);
    (most.ratio > RISES_IN_PART || together > WELL_BELOW).then_some(Wrong { most, together })
}

/// The worst over the parts of a flight.
struct Wrong {
    /// The error that rises most.
    most: Risen,
    /// All errors together over those of the file, where they fall least.
    together: f64,
}

impl Wrong {
    fn size(&self) -> f64 {
        self.most.ratio.max(self.together)
    }

    fn words(&self, judge: &Judge) -> String {
        let Self { most, together } = self;
        let what = if most.ratio > RISES_IN_PART {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::tests::seen;

    #[test]
    fn a_vehicle_must_help_in_every_part_that_can_be_judged() {
        let filed = || seen([0.4, 0.3, 0.01], [0.002; 3], 0.1, 0.05);
        let helps = || seen([0.2, 0.15, 0.01], [0.002; 3], 0.06, 0.04);
        let raises = seen([0.2, 0.15, 0.01], [0.002; 3], 0.112, 0.04);
        let by_chance = seen([0.2, 0.15, 0.01], [0.002; 3], 0.108, 0.04);
        let pushes = seen([0.47, 0.3, 0.01], [0.002; 3], 0.01, 0.01);
        let little = seen([0.39, 0.29, 0.01], [0.002; 3], 0.1, 0.05);
        let both = [filed(), filed()];
        assert!(wrong(&[helps(), helps()], &both).is_none());
        let risen = wrong(&[helps(), raises], &both).unwrap();
        assert!((risen.most.ratio - 1.12).abs() < 1e-12 && risen.most.channel.starts_with("position"));
        // A part has few roll-outs: a little is chance.
        assert!(wrong(&[helps(), by_chance], &both).is_none());
        let risen = wrong(&[helps(), pushes], &both).unwrap();
        assert!(risen.most.channel == "force" && risen.together < WELL_BELOW, "{:?}", risen.most);
        assert!(wrong(&[helps(), little], &both).unwrap().together > 0.98);
        // Parts that are too short for instants and roll-outs say nothing.
        assert!(wrong(&[helps(), Seen::default()], &[filed(), Seen::default()]).is_none());
        assert!(wrong(&[Seen::default()], &[Seen::default()]).is_none());
    }
}
