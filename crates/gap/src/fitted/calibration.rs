//! Calibration in groups, each judged on held-out flight, those that lower the error most first.

use super::Writer;
use crate::complete::{Completion, calibration, group};
use crate::error::Result;
use crate::headline::NO_HELP;
use crate::judge::{Judge, Seen};
use crate::policy::{GROUPS_SHOWN, LITTLE_GAIN, RISES_IN_STEP, WORSE};
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

    let mut steps = Steps { writer, judge, with: found.clone(), seen: base, out: Vec::new(), small: None };
    let mut left: Vec<Group> = Vec::new();
    for (_, tried) in order {
        match steps.tried(&of(adjusted, tried))? {
            Some((ratio, next)) if ratio < WORSE && steps.raises_nothing(&next) => {
                let entries = parameters(&of(adjusted, tried));
                steps.take(next, (tried.name().to_string(), entries));
                adjusted.iter_mut().filter(|c| group(&c.kind, c.area) == tried).for_each(|c| c.helps = true);
            }
            _ => left.push(tried),
        }
    }
    // What was fitted together may help together only: unequal rotors and a centre of mass make up for each other.
    loop {
        let pairs = (0..left.len()).flat_map(|i| (i + 1..left.len()).map(move |j| vec![i, j]));
        let mut sets: Vec<Vec<usize>> = pairs.collect();
        if left.len() > 2 {
            sets.push((0..left.len()).collect());
        }
        let list = |set: &[usize]| set.iter().flat_map(|i| of(adjusted, left[*i])).collect::<Vec<_>>();
        let tried: Vec<_> = sets.par_iter().map(|set| steps.tried(&list(set))).collect::<Result<_>>()?;
        let better = |t: Option<(f64, Next)>| {
            t.filter(|(ratio, next)| *ratio < LITTLE_GAIN && steps.raises_nothing(next))
        };
        let tried = tried.into_iter().zip(&sets).filter_map(|(t, set)| Some((better(t)?, set)));
        let Some(((_, next), set)) = tried.min_by(|a, b| a.0.0.total_cmp(&b.0.0)) else { break };
        let names: Vec<&str> = set.iter().map(|i| left[*i].name()).collect();
        let entries = parameters(&list(set));
        steps.take(next, (names.join(" with "), entries));
        let taken: Vec<Group> = set.iter().map(|i| left[*i]).collect();
        left.retain(|g| !taken.contains(g));
        adjusted.iter_mut().filter(|c| taken.contains(&group(&c.kind, c.area))).for_each(|c| c.helps = true);
    }
    let lists = left.into_iter().map(|one| of(adjusted, one));
    steps.rest(&lists.collect::<Vec<_>>())
}

/// A vehicle with one more step: its completion, itself, and what it looks like on the flight used for judging.
type Next = (Completion, Vehicle, Seen);

/// The steps so far.
struct Steps<'a> {
    writer: &'a Writer<'a>,
    judge: &'a Judge,
    with: Completion,
    seen: Seen,
    out: Vec<Shown>,
    /// Steps beyond those that are shown, as one: the last of them, and the number of their parameters.
    small: Option<(Vehicle, usize)>,
}

impl Steps<'_> {
    /// The vehicle with `list`, too, and its errors over those before; `None` where it cannot be simulated.
    fn tried(&self, list: &[Calibration]) -> Result<Option<(f64, Next)>> {
        let mut next = self.with.clone();
        next.calibrate(list)?;
        let vehicle = next.vehicle(self.writer.filed.vehicle)?;
        Ok(self.judge.look(&vehicle).ok().map(|then| (then.over(&self.seen), (next, vehicle, then))))
    }

    /// Whether no single error is much larger with it: a gain on the whole does not make up for that.
    fn raises_nothing(&self, (_, _, seen): &Next) -> bool {
        seen.most_risen(&self.seen).ratio <= RISES_IN_STEP
    }

    /// Takes a step of so many parameters.
    fn take(&mut self, (with, vehicle, seen): Next, (name, parameters): (String, usize)) {
        (self.with, self.seen) = (with, seen);
        if self.out.len() < GROUPS_SHOWN {
            self.out.push(Shown { label: format!("+ {name}"), vehicle, helps: true });
        } else {
            let before = self.small.take().map_or(0, |(_, n)| n);
            self.small = Some((vehicle, before + parameters));
        }
    }

    /// All steps, with what does not help as the last.
    fn rest(mut self, left: &[Vec<Calibration>]) -> Result<Vec<Shown>> {
        if let Some((vehicle, n)) = self.small {
            self.out.push(Shown { label: format!("+ the other {n} that help"), vehicle, helps: true });
        }
        if !left.is_empty() {
            for list in left {
                self.with.calibrate(list)?;
            }
            let n: usize = left.iter().map(|list| parameters(list)).sum();
            let vehicle = self.with.vehicle(self.writer.filed.vehicle)?;
            self.out.push(Shown { label: format!("+ the other {n}, {NO_HELP}"), vehicle, helps: false });
        }
        Ok(self.out)
    }
}

/// Number of parameters written from a list.
fn parameters(list: &[Calibration]) -> usize {
    calibration(list).iter().map(|e| e.parameters.len()).sum()
}
