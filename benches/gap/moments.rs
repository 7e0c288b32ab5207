//! Effects that come in mid-flight: whether the moment is found, when, and by which name; and flights in which nothing changes.

use super::Args;
use super::planted::{Excitation, fly, hidden::stream};
use super::score::{Case, Failure, same};
use propwash::gap::diagnose::{Moments, Settings, diagnose};
use propwash::gap::moments::Moment;
use propwash::vehicle::Vehicle;
use rayon::prelude::*;
use std::ops::Range;

/// A moment counts as found within this of the truth, s.
pub const WITHIN_S: f64 = 0.3;
/// Effects that come.
pub const KINDS: [&str; 10] = [
    "payload",
    "constant_wind",
    "weak_rotor.2",
    "wrong_mass",
    "com_offset",
    "thrust_scale",
    "torque_scale",
    "motor_lag",
    "linear_drag",
    "rotor_drag",
];
/// Share of the flight in which they come.
const AMONG: [f64; 2] = [0.2, 0.8];

/// One flight, and what became of it.
pub struct Tried {
    /// When the effect came, s; none where nothing changed.
    at_s: Option<f64>,
    hidden: &'static str,
    found: Vec<Moment>,
}

impl Tried {
    /// The moment that is nearest to the truth, and how far it is off, s.
    fn nearest(&self) -> Option<(&Moment, f64)> {
        let at_s = self.at_s?;
        let all = self.found.iter().map(|m| (m, (m.at_s - at_s).abs()));
        all.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Whether the moment was found in time.
    pub fn found(&self) -> bool {
        self.nearest().is_some_and(|(_, off)| off <= WITHIN_S)
    }

    /// Whether it has the right name, alone or among its look-alikes.
    pub fn named(&self) -> bool {
        let right =
            |m: &Moment| same(&m.id, self.hidden) || m.look_alikes.iter().any(|id| same(id, self.hidden));
        self.nearest().is_some_and(|(m, off)| off <= WITHIN_S && right(m))
    }

    /// Whether its interval holds the truth.
    pub fn held(&self) -> bool {
        let inside = |m: &Moment, t: f64| (m.interval_s[0]..=m.interval_s[1]).contains(&t);
        self.nearest().zip(self.at_s).is_some_and(|((m, _), t)| inside(m, t))
    }

    /// Number of moments that nobody planted.
    pub fn more(&self) -> usize {
        self.found.len() - usize::from(self.found())
    }

    fn line(&self, case: &Case) -> String {
        let one = |m: &Moment| {
            let or = if m.look_alikes.is_empty() {
                String::new()
            } else {
                format!(" or {}", m.look_alikes.join(", "))
            };
            format!(
                "{}{or} {:.2} s [{:.2}, {:.2}] {:.0} nats",
                m.id, m.at_s, m.interval_s[0], m.interval_s[1], m.evidence_nats
            )
        };
        let found: Vec<String> = self.found.iter().map(one).collect();
        let truth = self.at_s.map_or_else(|| "steady".into(), |t| format!("{t:.2} s"));
        let word = match self.at_s {
            Some(_) if self.more() > 0 => "MORE",
            Some(_) if self.named() => "named",
            Some(_) if self.found() => "OTHER NAME",
            Some(_) => "MISSED",
            None if self.found.is_empty() => "none",
            None => "FALSE",
        };
        format!("{:22} seed {:3}  {truth:8}  {word:10}  {}", self.hidden, case.seed, found.join("; "))
    }
}

/// What became of several flights.
pub struct Tries {
    pub tried: Vec<Tried>,
    /// Why the others were not: a planted flight that hits the ground is no flight of a pilot.
    pub not_flown: Vec<String>,
}

impl FromIterator<Result<Tried, String>> for Tries {
    fn from_iter<I: IntoIterator<Item = Result<Tried, String>>>(all: I) -> Self {
        let mut out = Self { tried: Vec::new(), not_flown: Vec::new() };
        for one in all {
            match one {
                Ok(tried) => out.tried.push(tried),
                Err(why) => out.not_flown.push(why),
            }
        }
        out
    }
}

/// All kinds with all seeds, each coming at a time of its own; otherwise as `base`.
pub fn changed(seeds: Range<u64>, base: &Case, vehicle: &Vehicle, args: &Args) -> Result<Tries, Failure> {
    let wanted = |id: &&str| args.kinds.is_empty() || args.kinds.iter().any(|k| k == id);
    let kinds: Vec<&'static str> = KINDS.into_iter().filter(wanted).collect();
    let each = kinds.into_iter().flat_map(|id| seeds.clone().map(move |seed| (id, seed)));
    each.collect::<Vec<_>>()
        .into_par_iter()
        .map(|(id, seed)| {
            let share = stream(seed, 0, "moment").uniform(AMONG[0], AMONG[1]);
            tried(&Case { hidden: vec![id], seed, ..base.clone() }, vehicle, Some(share * base.seconds), args)
        })
        .collect::<Result<Vec<_>, _>>()
        .map(Tries::from_iter)
}

/// Flights with one of these effects, or none (`none`), from the beginning on.
pub fn steady(
    effects: &[&'static str],
    seeds: Range<u64>,
    base: &Case,
    vehicle: &Vehicle,
    args: &Args,
) -> Result<Tries, Failure> {
    let each = effects.iter().flat_map(|id| seeds.clone().map(move |seed| (*id, seed)));
    each.collect::<Vec<_>>()
        .into_par_iter()
        .map(|(id, seed)| {
            let hidden = if id == "none" { vec![] } else { vec![id] };
            tried(&Case { hidden, seed, ..base.clone() }, vehicle, None, args)
        })
        .collect::<Result<Vec<_>, _>>()
        .map(Tries::from_iter)
}

/// Diagnoses a planted flight, or says why there is none.
fn tried(
    case: &Case,
    vehicle: &Vehicle,
    at_s: Option<f64>,
    args: &Args,
) -> Result<Result<Tried, String>, Failure> {
    let mut plan = case.plan(vehicle, 0);
    if at_s.is_some() {
        // What shows an effect may fly elsewhere than what the pilot does before it comes.
        plan.excitation = Excitation::MultiSine;
    }
    plan.begins_s = at_s;
    let flight = match fly(&plan) {
        Ok(flight) => flight,
        Err(why) => {
            let hidden = case.hidden.first().copied().unwrap_or("none");
            return Ok(Err(format!("{hidden}, seed {}: {why}", case.seed)));
        }
    };
    let track = case.track(vehicle, &flight)?;
    let settings =
        Settings { no_formulas: true, no_advice: true, moments: Moments::Tell, ..Settings::default() };
    let found = diagnose(&[track], vehicle, &settings)?.verdict.moments;
    let out = Tried { at_s, hidden: case.hidden.first().copied().unwrap_or("none"), found };
    if args.verbose {
        println!("{}", out.line(case));
    }
    Ok(Ok(out))
}
