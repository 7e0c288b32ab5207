//! The error ladder: errors of the nominal model and with one effect after the other added, at the instants and in
//! roll-outs, on the flight of the fit and on held-out flight.

use super::GapError;
use super::compare::HORIZONS_S;
use super::judge::Seen;
use super::track::{SHORTEST_S, Track};
use super::verdict::{HorizonError, Lack, LogSummary, Rung};
use propwash_vehicle::Vehicle;
use rayon::prelude::*;

/// Flights split into training and held-out flight.
pub struct Flights {
    /// Flights of the fit.
    pub fit: Vec<Track>,
    /// The same logs at their full length.
    pub whole: Vec<Track>,
    /// Held-out logs.
    pub held_out: Vec<Track>,
    /// Time in each log (s) from which on it is held out; `None` where the whole log is fitted.
    pub cut_s: Vec<Option<f64>>,
    /// Share of each log that was to be held out, 0 to 0.5.
    pub share: f64,
    /// What could not be held out.
    pub warnings: Vec<String>,
}

impl Flights {
    /// Logs for a fit and held-out logs. Without the latter, the last `share` (0 to 0.5) of each log is held out, where
    /// both parts stay at least [`SHORTEST_S`] long.
    pub fn new(logs: Vec<Track>, held_out: Vec<Track>, share: f64) -> Self {
        let mut out = Self {
            fit: logs.clone(),
            cut_s: vec![None; logs.len()],
            whole: logs,
            held_out,
            share,
            warnings: vec![],
        };
        if !out.held_out.is_empty() || share <= 0.0 {
            return out;
        }
        for (i, track) in out.whole.iter().enumerate() {
            let [from, to] = track.span_s;
            let cut = to - share * (to - from);
            if to - cut >= SHORTEST_S && cut - from >= SHORTEST_S {
                out.fit[i] = track.cut([from, cut]);
                out.cut_s[i] = Some(cut);
            } else {
                out.warnings.push(format!(
                    "{}: {:.1} s are too short to hold a part out: the fit sees all of it",
                    track.name,
                    to - from
                ));
            }
        }
        out
    }

    /// All logs at their full length, those of the fit first.
    pub fn all(&self) -> Vec<Track> {
        self.whole.iter().chain(&self.held_out).cloned().collect()
    }

    /// The logs as a verdict lists them: a split log twice.
    pub fn summaries(&self) -> Vec<LogSummary> {
        let one = |t: &Track, name: String, span_s: [f64; 2], held_out| LogSummary {
            name,
            sha256: t.log.sha256.clone(),
            duration_s: span_s[1] - span_s[0],
            drive: t.drive.title().into(),
            noise: t.noise,
            held_out,
        };
        let mut out = Vec::new();
        for (t, cut) in self.whole.iter().zip(&self.cut_s) {
            let [from, to] = t.span_s;
            match cut {
                Some(cut) => {
                    out.push(one(t, format!("{} to {cut:.1} s", t.name), [from, *cut], false));
                    out.push(one(t, format!("{} from {cut:.1} s", t.name), [*cut, to], true));
                }
                None => out.push(one(t, t.name.clone(), t.span_s, false)),
            }
        }
        out.extend(self.held_out.iter().map(|t| one(t, t.name.clone(), t.span_s, true)));
        out
    }

    /// Errors of a vehicle's roll-outs by horizon: on the flight of the fit, and on held-out flight (empty where there is
    /// none).
    ///
    /// # Errors
    /// [`GapError::Log`] where the vehicle lacks the dynamics, [`GapError::Numbers`] where a roll-out does not stay finite.
    pub fn errors(&self, vehicle: &Vehicle) -> Result<(Vec<HorizonError>, Vec<HorizonError>), GapError> {
        let [training, unseen] = self.look(&|_| vehicle)?;
        Ok((training.horizons, unseen.horizons))
    }

    /// Residuals of a vehicle for each flight, on the flight of the fit and on held-out flight.
    fn look<'v>(&self, of: &(dyn Fn(&Track) -> &'v Vehicle + Sync)) -> Result<[Seen; 2], GapError> {
        let one = |(track, cut): (&Track, &Option<f64>)| -> Result<[Seen; 2], GapError> {
            let [from, to] = track.span_s;
            let mut parts = match cut {
                Some(cut) => Seen::of(track, of(track), &[[from, *cut], [*cut, to]])?,
                None => Seen::of(track, of(track), &[[from, to]])?,
            };
            parts.resize_with(2, Seen::default);
            let unseen = parts.remove(1);
            Ok([parts.remove(0), unseen])
        };
        let mut parts: Vec<[Seen; 2]> =
            self.whole.par_iter().zip(&self.cut_s).map(one).collect::<Result<_, _>>()?;
        let held_out = |t: &Track| -> Result<[Seen; 2], GapError> {
            Ok([Seen::default(), Seen::of(t, of(t), &[t.span_s])?.remove(0)])
        };
        parts.extend(self.held_out.par_iter().map(held_out).collect::<Result<Vec<_>, _>>()?);
        let (training, unseen) = parts.into_iter().map(|[a, b]| (a, b)).unzip();
        Ok([Seen::together(training), Seen::together(unseen)])
    }

    /// One step for each vehicle, under its label.
    ///
    /// # Errors
    /// Those of [`Flights::errors`].
    pub fn ladder(&self, rungs: &[(String, Vehicle)]) -> Result<Vec<Rung>, GapError> {
        rungs.par_iter().map(|(label, vehicle)| self.rung_of_each(label.clone(), &|_| vehicle)).collect()
    }

    /// One step with a vehicle for each flight.
    ///
    /// # Errors
    /// Those of [`Flights::errors`].
    pub(crate) fn rung_of_each<'v>(
        &self,
        label: String,
        of: &(dyn Fn(&Track) -> &'v Vehicle + Sync),
    ) -> Result<Rung, GapError> {
        let [training, unseen] = self.look(of)?;
        Ok(Rung {
            label,
            training_lack: training.lack(),
            held_out_lack: unseen.lack(),
            training: training.horizons,
            held_out: unseen.horizons,
        })
    }
}

/// Steps of the ladders of several stretches of flight, over all of them: `parts` are added one after the other, each with its own steps.
pub(crate) fn together(parts: &[(String, Vec<Rung>)]) -> Vec<Rung> {
    let at = |now: &[usize], label: String| {
        let rungs: Vec<&Rung> = parts.iter().zip(now).filter_map(|((_, rungs), i)| rungs.get(*i)).collect();
        let all = |of: fn(&Rung) -> &[HorizonError]| pooled(&rungs.iter().map(|r| of(r)).collect::<Vec<_>>());
        let lack = |of: fn(&Rung) -> Option<Lack>| {
            let all: Vec<Lack> = rungs.iter().filter_map(|r| of(r)).collect();
            Lack::together(&all)
        };
        Rung {
            label,
            training: all(|r| &r.training),
            held_out: all(|r| &r.held_out),
            training_lack: lack(|r| r.training_lack),
            held_out_lack: lack(|r| r.held_out_lack),
        }
    };
    let mut now = vec![0; parts.len()];
    let Some(first) = parts.iter().find_map(|(_, rungs)| rungs.first()) else { return Vec::new() };
    let mut out = vec![at(&now, first.label.clone())];
    for (i, (name, rungs)) in parts.iter().enumerate() {
        for (step, rung) in rungs.iter().enumerate().skip(1) {
            now[i] = step;
            out.push(at(&now, format!("{}, {name}", rung.label)));
        }
    }
    out
}

/// Root mean squares over all roll-outs; horizons without roll-outs are left out.
pub(crate) fn pooled(parts: &[&[HorizonError]]) -> Vec<HorizonError> {
    let mut out: Vec<HorizonError> = Vec::new();
    for horizon_s in HORIZONS_S {
        let list: Vec<&HorizonError> =
            parts.iter().flat_map(|p| p.iter()).filter(|e| e.horizon_s == horizon_s && e.n > 0).collect();
        let n: usize = list.iter().map(|e| e.n).sum();
        if n == 0 {
            continue;
        }
        let mean = |pick: fn(&HorizonError) -> f64| {
            (list.iter().map(|e| pick(e).powi(2) * e.n as f64).sum::<f64>() / n as f64).sqrt()
        };
        out.push(HorizonError {
            horizon_s,
            position_m: mean(|e| e.position_m),
            velocity_m_s: mean(|e| e.velocity_m_s),
            attitude_rad: mean(|e| e.attitude_rad),
            rate_rad_s: mean(|e| e.rate_rad_s),
            n,
        });
    }
    out
}
