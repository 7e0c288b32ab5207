//! Decides what of the findings is named, and how surely: one rule after the other, each of which says why.

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
use crate::physics::effects::Area;
use remainder::{other_shape, remainder};
use rules::{Rule, Why};

/// Id of what no candidate describes, among look-alikes.
pub const UNLISTED: &str = "unlisted";

/// What stands in place of a finding where the logs cannot tell it from physics that is in no list.
fn unlisted() -> LookAlike {
    LookAlike {
        ids: vec![UNLISTED.into()],
        title: "something that is not in the list".into(),
        worse_by_nats: 0.0,
        manoeuvre: String::new(),
    }
}

/// What is named, and what stands against it.
pub(super) struct Decision<'a> {
    model: &'a Model,
    logs: &'a [Prepared<'a>],
    solution: &'a Solution,
    /// Whether the logs show too little to take anything back: then it stays, in doubt.
    poor: bool,
    pub findings: Vec<Finding>,
    /// Ids of findings that were taken back.
    pub nearest: Vec<String>,
    pub remainder: Remainder,
    /// Whether most of what is left is an event.
    event: bool,
    pub why: Vec<Why>,
}

impl<'a> Decision<'a> {
    /// Of findings, most evident first, beside what the windows' disturbances `left` say is left.
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
                Said::Silent => (Rule::SeenByOne, format!("{nats:.1} nats by the fit alone")),
                said => (Rule::TwoEstimators, format!("the regression {}", said.words())),
            };
            why.push(Why::new(&f.id, rule, format!("{sure}: {text}")));
        }
        Self { model, logs, solution, poor, findings, nearest: Vec::new(), remainder, event, why }
    }

    /// Whether the logs drive all of the model, not its forces only.
    fn wholly_driven(&self) -> bool {
        !forces_only(self.logs)
    }

    /// Takes the findings `of` back, as the nearest of what is in the list; from logs that show little they stay, in doubt.
    fn doubt(&mut self, rule: Rule, text: &str, of: impl Fn(&Finding) -> bool) {
        if self.poor {
            return self.keep_in_doubt(rule, text, of);
        }
        for f in self.findings.extract_if(.., |f| of(f)) {
            self.why.push(Why::new(&f.id, rule, format!("taken back: {text}")));
            self.nearest.push(f.id);
        }
    }

    /// Leaves the findings `of` in doubt: they could be something that is in no list.
    fn keep_in_doubt(&mut self, rule: Rule, text: &str, of: impl Fn(&Finding) -> bool) {
        for f in self.findings.iter_mut().filter(|f| of(f)) {
            self.why.push(Why::new(&f.id, rule, format!("in doubt: {text}")));
            if !f.look_alikes.iter().any(|l| l.ids == [UNLISTED]) {
                f.certain = false;
                f.look_alikes.push(unlisted());
            }
        }
    }

    /// Takes effects of the air back that are of another shape than what is missing.
    pub fn judge_shapes(&mut self, evidence: &Evidence, left: &[Sample]) {
        if !self.wholly_driven() {
            return;
        }
        let (model, solution) = (self.model, self.solution);
        for c in solution.set.iter().filter(|c| model.candidates[**c].area == Area::Airframe) {
            let id = &model.candidates[*c].id;
            let better = shapes::better(model, evidence, &solution.set, *c)
                .map(|(words, nats)| format!("{words} fits better than {id} by {nats:.0} nats"));
            // A shape that is left beside an effect may be a second thing that is missing: what the regression sees as well,
            // and nothing in the list stands in for, is in doubt only. Of a shape that fits in its place the regression says
            // nothing: it knows the list alone.
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
                self.remainder.unexplained = true;
                self.remainder.text = format!("{}; {words}", self.remainder.text);
                // What was found beside it, on less evidence, was found beside the wrong shape.
                let own = self.findings.iter().find(|f| f.id == *id).map_or(0.0, |f| f.evidence_nats);
                self.keep_in_doubt(Rule::OtherShape, &words, |f| f.evidence_nats <= own && agreed(f));
                self.doubt(Rule::OtherShape, &words, |f| f.evidence_nats <= own && !agreed(f));
            }
        }
    }

    /// Takes findings back that only lean on what is really missing: together they take away too little of the error on unseen
    /// flight (`together`), or of the disturbances. What is left is weather where it has no pattern.
    pub fn judge_together(&mut self, together: f64) {
        let doubtful_shape = !self.nearest.is_empty();
        let left = &self.remainder;
        let part = |after: f64, before: f64| 1.0 - (after / before).powi(2);
        let explained = part(left.force_m_s2, left.force_before_m_s2)
            .max(part(left.torque_rad_s2, left.torque_before_rad_s2));
        // Weather beside what is certain and no matter of the air: it leaves neither shape nor pattern, and takes no share itself.
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
            // Weather is a background: it takes nothing from what two independent estimators agree on.
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
        // Forces that are larger with the findings than without them were explained by none of them.
        if !wholly_driven && unexplained && explained < 0.0 {
            self.doubt(Rule::ForcesGrow, "more force is left with the findings than without", |_| true);
        }
        // Beside what is not explained, what no second estimator has felt is in doubt.
        for f in
            self.findings.iter_mut().filter(|f| f.second.said == Said::Silent && f.certain && unexplained)
        {
            f.certain = false;
            self.why.push(Why::new(&f.id, Rule::BesideUnexplained, "in doubt: something is unexplained"));
        }
        if let Some(f) = &found {
            let text = format!("{:.3} m/s² without a pattern", self.remainder.force_seen_m_s2());
            self.why.push(Why::new(&f.id, Rule::Weather, text));
        }
        self.findings.extend(found);
        let explained = self.findings.iter().any(|f| f.kind == "turbulence" && f.certain);
        self.remainder.unexplained &= !explained;
    }

    /// Says of effects that alone would be evident why they are not named.
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
                // The last fit holds the set, and no search that ended in another one was more evident.
                None if beside >= THRESHOLD => (Rule::Evidence, "no search settled on it".to_string()),
                None => (Rule::Evidence, "too little".to_string()),
            };
            let text = format!("not named: {alone:.1} nats alone, {beside:.1} beside what is; {reason}");
            self.why.push(Why::new(id, rule, text));
        }
    }

    /// The verdict in one sentence. `hidden`: how many effects could hide, where that is too many for a plain no.
    pub fn sentence(&self, hidden: usize) -> String {
        sentence(&self.findings, &self.remainder, &self.nearest, hidden)
    }
}

/// Most effects of which is said why they are not named.
const MOST_WHY_NOT: usize = 6;

fn sentence(findings: &[Finding], remainder: &Remainder, nearest: &[String], hidden: usize) -> String {
    let names: Vec<String> = findings
        .iter()
        .map(|f| {
            if f.certain {
                f.id.clone()
            } else if f.look_alikes.is_empty() {
                format!("{} (not certain: the second estimator {})", f.id, f.second.said.words())
            } else {
                let others: Vec<String> = f.look_alikes.iter().map(|l| l.ids.join(" + ")).collect();
                format!("{} (or {})", f.id, others.join(", or "))
            }
        })
        .collect();
    // What was taken back is told all the same.
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
