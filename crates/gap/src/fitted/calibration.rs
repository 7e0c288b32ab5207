//! Calibration in groups, each judged on held-out flight, those that lower the error most first.

use super::Writer;
use crate::complete::{Completion, calibration, group};
use crate::error::Result;
use crate::headline::NO_HELP;
use crate::judge::Judge;
use crate::policy::{GROUPS_SHOWN, WORSE};
use crate::verdict::Calibration;
use propwash_physics::effects::Group;
use propwash_vehicle::Vehicle;
use rayon::prelude::*;

/// A ladder step of the calibration.
pub(super) struct Shown {
    /// `+ rotors unequal`.
    pub label: String,
    /// The vehicle with this step and all before it.
    pub vehicle: Vehicle,
    /// Whether all of the step lowers the error.
    pub helps: bool,
}

/// Marks the parameters whose groups lower the error beside the findings in `found`, and returns the ladder steps: the best
/// groups by name, then the rest.
///
/// Empty where the vehicle cannot be simulated at all.
///
/// # Errors
/// If the text is not a valid vehicle file.
pub(super) fn judged(
    writer: &Writer,
    judge: &Judge,
    found: &Completion,
    adjusted: &mut [Calibration],
) -> Result<Vec<Shown>> {
    let of = |list: &[Calibration], one: Group| -> Vec<Calibration> {
        list.iter().filter(|c| !c.partner && group(&c.kind, c.area) == one).cloned().collect()
    };
    let Ok(base) = judge.look(&found.vehicle(writer.filed.vehicle)?) else { return Ok(Vec::new()) };
    // The gain of each group alone determines the order.
    let alone = |of_group: &Group| -> Result<Option<(f64, Group)>> {
        let mut one = found.clone();
        if one.calibrate(&of(adjusted, *of_group))? == 0 {
            return Ok(None);
        }
        let ratio = judge.look(&one.vehicle(writer.filed.vehicle)?).map_or(f64::INFINITY, |s| s.over(&base));
        Ok(Some((ratio, *of_group)))
    };
    let tried: Vec<Option<(f64, Group)>> = Group::ALL.par_iter().map(alone).collect::<Result<_>>()?;
    let mut order: Vec<(f64, Group)> = tried.into_iter().flatten().collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));

    let (mut with, mut seen) = (found.clone(), base);
    let (mut out, mut left): (Vec<Shown>, Vec<Group>) = (Vec::new(), Vec::new());
    let (mut small, mut small_entries) = (false, 0);
    for (_, tried) in order {
        let mut next = with.clone();
        let list = of(adjusted, tried);
        next.calibrate(&list)?;
        let vehicle = next.vehicle(writer.filed.vehicle)?;
        match judge.look(&vehicle) {
            Ok(then) if then.over(&seen) < WORSE => {
                (with, seen) = (next, then);
                adjusted.iter_mut().filter(|c| group(&c.kind, c.area) == tried).for_each(|c| c.helps = true);
                if out.len() < GROUPS_SHOWN {
                    out.push(Shown { label: format!("+ {}", tried.name()), vehicle, helps: true });
                } else {
                    small = true;
                    small_entries += parameters(&list);
                }
            }
            _ => left.push(tried),
        }
    }
    if small {
        let label = format!("+ the other {small_entries} that help");
        out.push(Shown { label, vehicle: with.vehicle(writer.filed.vehicle)?, helps: true });
    }
    if !left.is_empty() {
        let mut rest = 0;
        for one in left {
            let list = of(adjusted, one);
            with.calibrate(&list)?;
            rest += parameters(&list);
        }
        let label = format!("+ the other {rest}, {NO_HELP}");
        out.push(Shown { label, vehicle: with.vehicle(writer.filed.vehicle)?, helps: false });
    }
    Ok(out)
}

/// Number of parameters written from a list.
fn parameters(list: &[Calibration]) -> usize {
    calibration(list).iter().map(|e| e.parameters.len()).sum()
}
