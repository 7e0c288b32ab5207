//! The model's inputs along a log and their derivatives by every drive parameter: motors, delays, limits.

use super::fit::{N, NODE, Prepared, Wide};
use super::model::{Enters, Model};
use super::replay::{Driven, STEP, Tick, commanded_by_pose, drive};
use super::track::Drive;
use propwash_physics::drone::Drone;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// Drive parameters per pass of duals.
const N_DRIVE: usize = 4;
const _: () = assert!(propwash_physics::effects::custom::differentiates(N_DRIVE));
type DriveDual = Dual<f64, N_DRIVE>;

/// Inputs with their derivatives by the drive parameters at every node of a log.
pub(super) struct DriveInputs {
    pub ticks: Vec<Tick<f64>>,
    /// For every drive parameter, per node: derivatives of rotor speeds and rates, thrust and commands.
    slopes: Vec<(usize, Vec<Tick<f64>>)>,
}

impl DriveInputs {
    /// A tick at a node with its derivatives by the parameters of one pass, one per dual direction; `tick` has none.
    pub fn by<'a>(&self, parameters: &[usize], tick: &'a Tick<Wide>, node: usize) -> Cow<'a, Tick<Wide>> {
        if self.slopes.is_empty() {
            return Cow::Borrowed(tick);
        }
        let mut out = *tick;
        for (slot, k) in parameters.iter().enumerate().take(N) {
            let list = self.slopes.iter().find(|(of, _)| of == k).map(|(_, list)| list);
            let Some(slopes) = list.and_then(|list| list.get(node)) else { continue };
            let seed = |numbers: &mut [Wide], slopes: &[f64]| {
                numbers.iter_mut().zip(slopes).for_each(|(x, slope)| x.partials[slot] = *slope);
            };
            seed(&mut out.rotor_vel, &slopes.rotor_vel);
            seed(&mut out.rotor_acc, &slopes.rotor_acc);
            seed(&mut out.command, &slopes.command);
            out.thrust.partials[slot] = slopes.thrust;
        }
        Cow::Owned(out)
    }
}

/// Inputs at the ticks of `asked`, ranges in rising order that do not touch; by commands those of all others are zero.
pub(super) fn drive_inputs(
    log: &Prepared,
    model: &Model,
    values: &[f64],
    chosen: &[usize],
    asked: &[Range<usize>],
) -> DriveInputs {
    let plain = model.plain_at(values, chosen);
    let free: Vec<usize> = (0..values.len())
        .filter(|k| match model.parameters[*k].enters {
            Enters::Clock([pose, ..]) => pose != 0,
            enters => enters == Enters::Drive,
        })
        .collect();
    if !matches!(log.track.drive, Drive::RotorCommands | Drive::AttitudeCommands) {
        let ticks = drive(log.track, &log.around, &log.raw, &plain);
        return DriveInputs { ticks, slopes: Vec::new() };
    }
    // A limit that no command reaches has derivative zero: until it is in the set, its column is a secant over half a slab.
    let (limits, free): (Vec<usize>, Vec<usize>) = free.into_iter().partition(|k| {
        let p = &model.parameters[*k];
        p.name == "max_rotor_vel_rad_s" && !chosen.contains(&p.candidate)
    });
    let far = |k: usize| -0.5 * model.parameters[k].slab;
    let at_asked = |drone: &Drone<f64>| {
        let driven = commanded_by_pose(log.track, &log.around, &log.raw, drone, asked);
        let mut ticks = vec![Tick::zero(); driven.n_ticks()];
        asked.iter().cloned().flatten().for_each(|k| ticks[k] = driven.tick(k, |x| x));
        ticks
    };
    let limited = |k: &usize| {
        let mut there = values.to_vec();
        there[*k] += far(*k);
        let mut keep = model.effects_of(chosen);
        keep[model.parameters[*k].effect] = true;
        at_asked(&model.drone_at(&there, &keep, |_, v| v))
    };
    let by_duals = |group: &[usize]| -> Vec<(usize, Vec<Tick<f64>>)> {
        let mut keep = model.effects_of(chosen);
        group.iter().for_each(|k| keep[model.parameters[*k].effect] = true);
        let drone = model.drone_at(values, &keep, |k, v| match group.iter().position(|g| *g == k) {
            Some(slot) => DriveDual::input(v, slot),
            None => DriveDual::lit(v),
        });
        let all: Driven<DriveDual> = commanded_by_pose(log.track, &log.around, &log.raw, &drone, asked);
        let slope = |slot: usize| around_nodes(all.n_ticks(), asked, |i| all.tick(i, |d| d.partials[slot]));
        group.iter().enumerate().map(|(slot, k)| (*k, slope(slot))).collect()
    };
    // A log is one serial chain of motor states, so the passes run in parallel instead.
    let (smooth, (ticks, limited)): (Vec<_>, (_, Vec<_>)) = rayon::join(
        || free.par_chunks(N_DRIVE).flat_map_iter(by_duals).collect(),
        || rayon::join(|| at_asked(&plain), || limits.par_iter().map(limited).collect()),
    );
    let mut slopes: Vec<(usize, Vec<Tick<f64>>)> = limits
        .iter()
        .zip(&limited)
        .map(|(k, there)| {
            let secant = |a: f64, b: f64| (b - a) / far(*k);
            (*k, around_nodes(ticks.len(), asked, |i| ticks[i].with(&there[i], secant)))
        })
        .collect();
    slopes.extend(smooth);
    DriveInputs { ticks, slopes }
}

/// Means around every node of `n` ticks under a hat function that is zero at the neighbouring nodes: jumps between ticks do
/// not alias, and the sum over a window is preserved. Zero at nodes that are not asked for.
fn around_nodes(n: usize, asked: &[Range<usize>], tick: impl Fn(usize) -> Tick<f64>) -> Vec<Tick<f64>> {
    let spacing = STEP * NODE;
    let apart = spacing as isize;
    let mut out = vec![Tick::zero(); n.div_ceil(spacing)];
    for range in asked {
        // Ticks beside a range are unknown: the mean ends there, as at the ends of a log.
        let last = range.end as isize - 1;
        for at in (range.start.next_multiple_of(spacing)..range.end).step_by(spacing) {
            let mean = &mut out[at / spacing];
            for offset in 1 - apart..apart {
                let weight = (apart - offset.abs()) as f64 / (apart * apart) as f64;
                let place = (at as isize + offset).clamp(range.start as isize, last) as usize;
                *mean = mean.with(&tick(place), |sum, x| sum + weight * x);
            }
        }
    }
    out
}
