//! Decides which findings are named, and how certain they are: rules are applied one after the other, and each records why.

pub(super) mod remainder;
pub mod rules;
mod weather;

use super::fit::{Prepared, forces_only};
use super::free_form::Sample;
use super::model::Model;
use super::policy::{BESIDE_WEATHER, EVENTFUL, LEANING};
use super::search::{Evidence, THRESHOLD};
use super::shapes;
use super::solve::Solution;
use super::verdict::{Finding, LookAlike, Remainder, Said};
use propwash_physics::effects::Area;
use remainder::{other_shape, remainder};
use rules::{Rule, Why};

/// Id among look-alikes of an effect that is not in the list of candidates.
pub const UNLISTED: &str = "unlisted";

/// Look-alike of a finding that the logs cannot tell from physics that is not in the list.
fn unlisted() -> LookAlike {
    LookAlike {
        ids: vec![UNLISTED.into()],
        title: "something that is not in the list".into(),
        worse_by_nats: 0.0,
        manoeuvre: String::new(),
    }
}

/// What is named, and what speaks against it.
pub(super) struct Decision<'a> {
    model: &'a Model,
    logs: &'a [Prepared<'a>],
    solution: &'a Solution,
    /// Whether the logs excite too little to withdraw a finding: it is then kept, in doubt.
    poor: bool,
    pub findings: Vec<Finding>,
    /// Ids of withdrawn findings.
    pub nearest: Vec<String>,
    pub remainder: Remainder,
    /// Whether most of the residual is an event.
    event: bool,
    pub why: Vec<Why>,
}

impl<'a> Decision<'a> {
    /// From findings, most evident first; `left` are the windows' disturbances beside them.
    pub fn new(
        model: &'a Model,
        logs: &'a [Prepared<'a>],
        solution: &'a Solution,
        left: &[Sample],
        findings: Vec<Finding>,
        poor: bool,
    ) -> Self {
        let (remainder, event) = remainder(logs, model, solution, left);
        let mut why = Vec::new();
        for f in &findings {
            let nats = f.evidence_nats;
            why.push(Why::new(&f.id, Rule::Evidence, format!("{nats:.1} nats beside the others")));
            let sure = if f.certain { "certain" } else { "in doubt" };
            let others: Vec<String> = f.look_alikes.iter().map(|l| l.ids.join(" + ")).collect();
            let (rule, text) = match f.second.said {
                _ if !others.is_empty() => (Rule::LookAlikes, format!("{} fit as well", others.join(", "))),
                Said::TooLarge => (Rule::TooLargeAlone, format!("{nats:.1} nats by the fit alone")),
                Said::Silent => (Rule::SeenByOne, format!("{nats:.1} nats by the fit alone")),
                said => (Rule::TwoEstimators, format!("the regression {}", said.words())),
            };
            why.push(Why::new(&f.id, rule, format!("{sure}: {text}")));
        }
        Self { model, logs, solution, poor, findings, nearest: Vec::new(), remainder, event, why }
    }

    /// Whether the logs drive the whole model, not only its forces.
    fn wholly_driven(&self) -> bool {
        !forces_only(self.logs)
    }

    /// Withdraws the findings `of`, as the nearest in the list; with poorly excited logs they are kept, in doubt.
    fn doubt(&mut self, rule: Rule, text: &str, of: impl Fn(&Finding) -> bool) {
        if self.poor {
            return self.keep_in_doubt(rule, text, of);
        }
        for f in self.findings.extract_if(.., |f| of(f)) {
            self.why.push(Why::new(&f.id, rule, format!("taken back: {text}")));
            self.nearest.push(f.id);
        }
    }

    /// Marks the findings `of` as in doubt: they could be physics that is not in the list.
    fn keep_in_doubt(&mut self, rule: Rule, text: &str, of: impl Fn(&Finding) -> bool) {
        for f in self.findings.iter_mut().filter(|f| of(f)) {
            self.why.push(Why::new(&f.id, rule, format!("in doubt: {text}")));
            if !f.look_alikes.iter().any(|l| l.ids == [UNLISTED]) {
                f.certain = false;
                f.look_alikes.push(unlisted());
            }
        }
    }

    /// Withdraws effects of the air whose shape differs from that of what is missing.
    pub fn judge_shapes(&mut self, evidence: &Evidence, left: &[Sample]) {
        if !self.wholly_driven() {
            return;
        }
        let (model, solution) = (self.model, self.solution);
        for c in solution.set.iter().filter(|c| model.candidates[**c].area == Area::Airframe) {
            let id = &model.candidates[*c].id;
            let better = shapes::instead(model, evidence, &solution.set, *c)
                .map(|(words, nats)| format!("{words} fits better than {id} by {nats:.0} nats"));
            // A shape left beside an effect may be a second missing effect: what the regression sees as well, and nothing
            // in the list replaces, is only in doubt. A shape that fits in its place is not judged by the regression, which
            // knows only the list.
            let in_place = better.is_some();
            let agreed = |f: &Finding| {
                !in_place
                    && f.second.said == Said::Agrees
                    && f.look_alikes.iter().all(|l| l.ids == [UNLISTED])
            };
            let other = better.or_else(|| {
                let term = other_shape(self.logs, model, solution, *c, left)?;
                Some(format!("{id} leaves a shape that goes with {term}"))
            });
            if let Some(words) = other {
                (self.remainder.unexplained, self.remainder.faint) = (true, false);
                self.remainder.text = format!("{}; {words}", self.remainder.text);
                // Findings beside it with less evidence were found beside the wrong shape.
                let own = self.findings.iter().find(|f| f.id == *id).map_or(0.0, |f| f.evidence_nats);
                self.keep_in_doubt(Rule::OtherShape, &words, |f| f.evidence_nats <= own && agreed(f));
                self.doubt(Rule::OtherShape, &words, |f| f.evidence_nats <= own && !agreed(f));
            }
        }
    }

    /// Withdraws findings that only lean on what is really missing: together they remove too little of the held-out error
    /// (`together`), or of the disturbances. A remainder without a pattern is turbulence.
    /// Where a formula stands among the candidates (`by_formula`), what only one estimator sees is in doubt as it is beside a remainder.
    pub fn judge_together(&mut self, together: f64, by_formula: bool) {
        let doubtful_shape = !self.nearest.is_empty();
        let left = &self.remainder;
        let part = |after: f64, before: f64| 1.0 - (after / before).powi(2);
        let explained = part(left.force_m_s2, left.force_before_m_s2)
            .max(part(left.torque_rad_s2, left.torque_before_rad_s2));
        // Turbulence beside findings that are certain and no effects of the air: it leaves neither shape nor pattern, and
        // needs no share.
        let sure = |f: &Finding| f.certain && f.area != Area::Airframe && f.evidence_nats >= BESIDE_WEATHER;
        let wholly_driven = self.wholly_driven();
        let (unexplained, event) = (left.unexplained, self.event);
        let drift = unexplained && !doubtful_shape && !event;
        let weather = |d: &Self| weather::turbulence(d.model, d.logs, d.solution, &d.remainder, d.poor);
        let beside =
            !self.findings.is_empty() && !self.poor && wholly_driven && self.findings.iter().all(sure);
        let mut found = if drift && beside { weather(self) } else { None };
        let little = together < 0.5 || explained < LEANING || (event && explained < EVENTFUL);
        if wholly_driven && found.is_none() && unexplained && little {
            // Turbulence is a background: it does not withdraw what two independent estimators agree on.
            let background = if drift { weather(self) } else { None };
            let stands = |f: &Finding| f.second.said == Said::Agrees && f.evidence_nats >= BESIDE_WEATHER;
            let shielded = background.is_some();
            let text = format!(
                "all findings take {:.0} % of the error on unseen windows and {:.0} % of the disturbances' variance",
                100.0 * together,
                100.0 * explained
            );
            self.doubt(Rule::Leaning, &text, |f| !(shielded && stands(f)));
            if shielded && !self.findings.is_empty() {
                found = background;
            }
        }
        if drift && self.findings.is_empty() {
            found = weather(self);
        }
        // If forces are larger with the findings than without, the findings explained none of them.
        if !wholly_driven && unexplained && explained < 0.0 {
            self.doubt(Rule::ForcesGrow, "more force is left with the findings than without", |_| true);
        }
        // Beside an unexplained remainder, what the second estimator cannot confirm is in doubt. A formula is the nearest of a list to
        // the law that it stands for, and what it misses looks like sensors.
        let text = match (unexplained, by_formula) {
            (true, _) => Some("in doubt: something is unexplained"),
            (false, true) => Some("in doubt: a formula stands for the law of what is missing"),
            (false, false) => None,
        };
        for f in self.findings.iter_mut().filter(|f| f.second.said == Said::Silent && f.certain) {
            if let Some(text) = text {
                f.certain = false;
                self.why.push(Why::new(&f.id, Rule::BesideUnexplained, text));
            }
        }
        if let Some(f) = &found {
            let text = format!("{:.3} m/s² without a pattern", self.remainder.force_seen_m_s2());
            self.why.push(Why::new(&f.id, Rule::Weather, text));
        }
        self.findings.extend(found);
        let explained = self.findings.iter().any(|f| f.kind == "turbulence" && f.certain);
        self.remainder.unexplained &= !explained;
        self.remainder.faint &= !explained;
    }

    /// Says why effects that are evident alone are not named.
    pub fn say_why_not(&mut self, evidence: &Evidence, singles: &[(String, f64)]) {
        let whole = evidence.of(&self.solution.set);
        for (id, alone) in singles.iter().filter(|(_, nats)| *nats > THRESHOLD).take(MOST_WHY_NOT) {
            let named = self.why.iter().any(|w| w.id == *id);
            let candidate = self.model.candidates.iter().position(|c| c.id == *id);
            let Some(c) = candidate.filter(|c| !named && !self.solution.set.contains(c)) else { continue };
            let mut with = self.solution.set.clone();
            with.push(c);
            with.sort_unstable();
            let beside = evidence.of(&with) - whole;
            let stands_in = |f: &&Finding| f.look_alikes.iter().any(|l| l.ids.contains(id));
            let (rule, reason) = match self.findings.iter().find(stands_in) {
                Some(f) => (Rule::LookAlikes, format!("it could stand in the place of {}", f.id)),
                // The last fit contains the set, and no search that ended in another one had more evidence.
                None if beside >= THRESHOLD => (Rule::Evidence, "no search settled on it".to_string()),
                None => (Rule::Evidence, "too little".to_string()),
            };
            let text = format!("not named: {alone:.1} nats alone, {beside:.1} beside what is; {reason}");
            self.why.push(Why::new(id, rule, text));
        }
    }

    /// The verdict in one sentence. `hidden`: number of effects that could be hidden, if too many for a plain no.
    pub fn sentence(&self, hidden: usize) -> String {
        sentence(&self.findings, &self.remainder, &self.nearest, hidden)
    }
}

/// Most effects for which it is said why they are not named.
const MOST_WHY_NOT: usize = 6;

/// The verdict in one sentence; `hidden`: number of effects that could be hidden, if too many for a plain no.
pub(crate) fn sentence(
    findings: &[Finding],
    remainder: &Remainder,
    nearest: &[String],
    hidden: usize,
) -> String {
    let names: Vec<String> = findings
        .iter()
        .map(|f| {
            if f.certain {
                f.id.clone()
            } else if f.look_alikes.is_empty() {
                format!("{} (not certain: the second estimator {})", f.id, f.second.said.words())
            } else {
                let others: Vec<String> = f.look_alikes.iter().map(|l| l.ids.join(" + ")).collect();
                let doubt = match f.one_of_several() {
                    true => String::new(),
                    false => format!("; not certain: the second estimator {}", f.second.said.words()),
                };
                format!("{} (or {}{doubt})", f.id, others.join(", or "))
            }
        })
        .collect();
    // Withdrawn findings are mentioned all the same.
    let seen = |text: String| match nearest {
        [] => text,
        near => format!("{text} (seen, but not enough to be sure: {})", near.join(", ")),
    };
    match (findings.is_empty(), remainder.unexplained) {
        (true, false) if hidden == 0 => "nothing is missing".into(),
        (true, false) => {
            format!(
                "nothing is missing that these logs could show; {hidden} effects of usual size could hide in them"
            )
        }
        (false, false) => seen(format!("missing: {}", names.join("; "))),
        (false, true) => seen(format!("missing: {}; and something unexplained is left", names.join("; "))),
        (true, true) if nearest.is_empty() => {
            "unexplained: something is missing that is not in the list".into()
        }
        (true, true) => format!(
            "unexplained: something is missing that is not in the list (nearest, but not enough: {})",
            nearest.join(", ")
        ),
    }
}
