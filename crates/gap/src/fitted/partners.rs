//! Groups of parameters within tolerance that were fitted together with the findings: if the findings alone raise a
//! held-out error, the groups that lower it again are written with them.
//!
//! Example: a weak rotor lowers the thrust; if the other rotors give more than nominal, both were one fit, and the weak
//! rotor alone makes the force worse.
//!
//! Sensor offsets and clocks are never such partners: they belong to the log. Clocks that were right for one filtered
//! flight nearly doubled the missing torque on the next.

use super::{Writer, findings};
use crate::complete::group;
use crate::error::Result;
use crate::headline::pair;
use crate::judge::{Judge, Seen};
use crate::policy::{MOST_PARTNERS, RISES, WELL_BELOW, WORSE};
use crate::report::significant;
use crate::verdict::{Calibration, Finding, HeldOut};
use propwash_physics::effects::Group;
use rayon::prelude::*;

/// Judges the findings `writable`, by index: returns those to write, and marks the groups written with them.
///
/// Findings that are dropped by themselves are judged once more together with all that was fitted with them: that is
/// written if it is clearly better.
///
/// # Errors
/// If the text is not a valid vehicle file.
pub(super) fn judged(
    writer: &Writer,
    judge: &Judge,
    findings: &mut Vec<Finding>,
    writable: Vec<usize>,
    adjusted: &mut [Calibration],
) -> Result<Vec<usize>> {
    let mut alone = findings.clone();
    let kept = findings::judged(writer, judge, &mut alone, writable.clone())?;
    if kept.len() < writable.len()
        && let Ok(filed) = judge.look(writer.filed.vehicle)
    {
        let (ratio, groups) = partners(writer, judge, findings, &writable, adjusted, &filed)?;
        let mut with = writer.clone();
        with.partners.extend(adjusted.iter().filter(|c| groups.contains(&group(&c.kind, c.area))).cloned());
        let mut together = findings.clone();
        let more = match ratio <= RISES && !with.partners.is_empty() {
            true => findings::judged(&with, judge, &mut together, writable)?,
            false => Vec::new(),
        };
        let seen = |w: &Writer, f: &[Finding], kept: &[usize]| -> Result<Seen> {
            Ok(judge.look(&w.with(f, kept)?)?)
        };
        if more.len() > kept.len()
            && let (Ok(a), Ok(b)) = (seen(&with, &together, &more), seen(writer, &alone, &kept))
            && a.over(&b) < WELL_BELOW
            && a.most_risen(&filed).ratio <= RISES
        {
            for c in adjusted.iter_mut().filter(|c| groups.contains(&group(&c.kind, c.area))) {
                c.partner = true;
            }
            *findings = together;
            return Ok(more);
        }
    }
    *findings = alone;
    joined(writer, judge, findings, kept, adjusted)
}

/// Marks the groups written with the findings `kept` and returns the findings that stay: one that still raises an error is
/// in doubt.
fn joined(
    writer: &Writer,
    judge: &Judge,
    findings: &mut [Finding],
    mut kept: Vec<usize>,
    adjusted: &mut [Calibration],
) -> Result<Vec<usize>> {
    // Nothing can rise above a nominal vehicle that never stays finite.
    let Ok(filed) = judge.look(writer.filed.vehicle) else { return Ok(kept) };
    while !kept.is_empty() {
        let alone = match judge.look(&writer.with(findings, &kept)?) {
            Ok(seen) => seen.most_risen(&filed),
            Err(_) => return Ok(kept),
        };
        if alone.ratio <= WORSE {
            return Ok(kept);
        }
        let (ratio, partners) = partners(writer, judge, findings, &kept, adjusted, &filed)?;
        // With a margin: what just holds on this flight would not hold on another.
        if ratio < alone.ratio && ratio <= RISES {
            for c in adjusted.iter_mut().filter(|c| partners.contains(&group(&c.kind, c.area))) {
                c.partner = true;
            }
            return Ok(kept);
        }
        if alone.ratio <= RISES {
            return Ok(kept);
        }
        let risen = |rest: &[usize]| -> Result<f64> {
            let seen = judge.look(&writer.with(findings, rest)?);
            Ok(seen.map_or(f64::INFINITY, |s| s.most_risen(&filed).ratio))
        };
        let Some(out) = least_missed(&kept, risen)? else { break };
        let words = format!(
            "with it the {} error on {} is {} times that of the file ({}): not written",
            alone.channel,
            judge.title(),
            significant(alone.ratio, 3),
            pair(alone.filed, alone.now, alone.unit),
        );
        doubt(&mut findings[out], words);
        kept.retain(|index| *index != out);
    }
    Ok(kept)
}

/// The finding without which the vehicle is best; `error` measures the vehicle with the others.
pub(super) fn least_missed(
    kept: &[usize],
    error: impl Fn(&[usize]) -> Result<f64> + Sync,
) -> Result<Option<usize>> {
    let without = |index: &usize| -> Result<(f64, usize)> {
        let rest: Vec<usize> = kept.iter().copied().filter(|k| k != index).collect();
        Ok((error(&rest)?, *index))
    };
    let tried: Vec<(f64, usize)> = kept.par_iter().map(without).collect::<Result<_>>()?;
    Ok(tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, index)| index))
}

/// Leaves a finding in doubt and out of the file, with the reason.
pub(super) fn doubt(finding: &mut Finding, words: String) {
    finding.certain = false;
    if let Some(told) = finding.held_out.take() {
        finding.held_out = Some(HeldOut { written: false, doubt: Some(words), ..told });
    }
}

/// Groups that keep the errors lowest, at most [`MOST_PARTNERS`], and the largest ratio of an error to the nominal one with
/// them: first until no error rises, then until all errors together fall clearly.
fn partners(
    writer: &Writer,
    judge: &Judge,
    findings: &[Finding],
    kept: &[usize],
    adjusted: &[Calibration],
    filed: &Seen,
) -> Result<(f64, Vec<Group>)> {
    let mut chosen: Vec<Group> = Vec::new();
    let mut best = [f64::INFINITY; 2];
    while chosen.len() < MOST_PARTNERS {
        let with = |one: &Group| -> Result<([f64; 2], Group)> {
            let mut completion = writer.completed(findings, kept)?;
            let mine = |c: &&Calibration| {
                let of = group(&c.kind, c.area);
                of == *one || chosen.contains(&of)
            };
            completion.calibrate(&adjusted.iter().filter(mine).cloned().collect::<Vec<_>>())?;
            let seen = judge.look(&completion.vehicle(writer.filed.vehicle)?);
            let errors = |s: Seen| [s.most_risen(filed).ratio.max(WORSE), s.over(filed)];
            Ok((seen.map_or([f64::INFINITY; 2], errors), *one))
        };
        let of_the_vehicle = |g: &Group| !g.of_the_log() && !chosen.contains(g);
        let open: Vec<Group> = Group::ALL.into_iter().filter(of_the_vehicle).collect();
        let tried: Vec<([f64; 2], Group)> = open.par_iter().map(with).collect::<Result<_>>()?;
        let lower = |a: &[f64; 2], b: &[f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
        let Some((errors, group)) = tried.into_iter().min_by(|a, b| lower(&a.0, &b.0)) else { break };
        if !(errors[0] < best[0] || (errors[0] <= best[0] && errors[1] < WELL_BELOW * best[1])) {
            break;
        }
        best = errors;
        chosen.push(group);
    }
    Ok((best[0], chosen))
}
