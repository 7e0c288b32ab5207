//! What was found, with what was fitted together with it: where an error on unseen flight rises with the findings alone, the
//! groups of parameters within tolerance that bring it down again are written with them.
//!
//! A weak rotor takes thrust away; where the other rotors give more than filed, the two were one fit, and the weak rotor alone
//! makes the force worse.
//!
//! Offsets and clocks of sensors are no such partners: they belong to the log. Clocks that were right for one filtered flight nearly doubled
//! the torque that was missing on the next.

use super::{Writer, findings};
use crate::Result;
use crate::gap::complete::{GROUPS, OF_THE_LOG, group};
use crate::gap::headline::pair;
use crate::gap::judge::{Judge, Seen};
use crate::gap::policy::{MOST_PARTNERS, RISES, WELL_BELOW, WORSE};
use crate::gap::report::significant;
use crate::gap::verdict::{Calibration, Finding, HeldOut};
use rayon::prelude::*;

/// Judges the findings `writable`, by index: gives those to write, and marks the groups that are written with them.
///
/// Findings that are left out by themselves are judged once more with what was fitted together with all of them: that is written where
/// it is clearly better.
///
/// # Errors
/// Where the text is no vehicle file.
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

/// Marks the groups that are written with the findings `kept` and gives the findings that stay: one that raises an error all
/// the same is in doubt.
fn joined(
    writer: &Writer,
    judge: &Judge,
    findings: &mut [Finding],
    mut kept: Vec<usize>,
    adjusted: &mut [Calibration],
) -> Result<Vec<usize>> {
    // Where the filed vehicle flies nowhere, nothing rises.
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
        // Another flight is not quite this one: what just holds here would not there.
        if ratio < alone.ratio && ratio <= RISES {
            for c in adjusted.iter_mut().filter(|c| partners.contains(&group(&c.kind, c.area))) {
                c.partner = true;
            }
            return Ok(kept);
        }
        if alone.ratio <= RISES {
            return Ok(kept);
        }
        // The finding without which the errors rise least.
        let without = |index: &usize| -> Result<(f64, usize)> {
            let rest: Vec<usize> = kept.iter().copied().filter(|k| k != index).collect();
            let seen = judge.look(&writer.with(findings, &rest)?);
            Ok((seen.map_or(f64::INFINITY, |s| s.most_risen(&filed).ratio), *index))
        };
        let tried: Vec<(f64, usize)> = kept.par_iter().map(without).collect::<Result<_>>()?;
        let Some((_, out)) = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        let words = format!(
            "with it the {} error on {} is {} times that of the file ({}): not written",
            alone.channel,
            judge.title(),
            significant(alone.ratio, 3),
            pair(alone.filed, alone.now, alone.unit),
        );
        let f = &mut findings[out];
        f.certain = false;
        if let Some(told) = f.held_out.take() {
            f.held_out = Some(HeldOut { written: false, doubt: Some(words), ..told });
        }
        kept.retain(|index| *index != out);
    }
    Ok(kept)
}

/// Groups that keep the errors lowest, at most [`MOST_PARTNERS`], and the largest ratio of an error to the file's with them: first
/// that nothing rises, then that all errors together fall clearly.
fn partners(
    writer: &Writer,
    judge: &Judge,
    findings: &[Finding],
    kept: &[usize],
    adjusted: &[Calibration],
    filed: &Seen,
) -> Result<(f64, Vec<&'static str>)> {
    let mut chosen: Vec<&'static str> = Vec::new();
    let mut best = [f64::INFINITY; 2];
    while chosen.len() < MOST_PARTNERS {
        let with = |name: &&'static str| -> Result<([f64; 2], &'static str)> {
            let mut completion = writer.completed(findings, kept)?;
            let mine = |c: &&Calibration| {
                let of = group(&c.kind, c.area);
                of == *name || chosen.contains(&of)
            };
            completion.calibrate(&adjusted.iter().filter(mine).cloned().collect::<Vec<_>>())?;
            let seen = judge.look(&completion.vehicle(writer.filed.vehicle)?);
            let errors = |s: Seen| [s.most_risen(filed).ratio.max(WORSE), s.over(filed)];
            Ok((seen.map_or([f64::INFINITY; 2], errors), *name))
        };
        let of_the_vehicle = |g: &&str| !OF_THE_LOG.contains(g) && !chosen.contains(g);
        let open: Vec<&'static str> = GROUPS.iter().copied().filter(of_the_vehicle).collect();
        let tried: Vec<([f64; 2], &'static str)> = open.par_iter().map(with).collect::<Result<_>>()?;
        let lower = |a: &[f64; 2], b: &[f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
        let Some((errors, name)) = tried.into_iter().min_by(|a, b| lower(&a.0, &b.0)) else { break };
        if !(errors[0] < best[0] || (errors[0] <= best[0] && errors[1] < WELL_BELOW * best[1])) {
            break;
        }
        best = errors;
        chosen.push(name);
    }
    Ok((best[0], chosen))
}
