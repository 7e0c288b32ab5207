//! The whole table: effects alone, in pairs, none, unlisted, on ordinary flights; closure, intervals, times.

use super::Args;
use super::formulas;
use super::moments;
use super::planted::hidden::stream as planted_stream;
use super::planted::{Build, Excitation, HIDDEN, Inputs, NoiseLevel, UNLISTED, id};
use super::score::{Case, Outcome};
use propwash::vehicle::Vehicle;
use rayon::prelude::*;
use std::collections::BTreeMap;

const LEVELS: [NoiseLevel; 2] = [NoiseLevel::Fine, NoiseLevel::Rough];
pub const PARTS: [&str; 9] =
    ["single", "pairs", "none", "unlisted", "formulas", "moments", "steady", "ordinary", "time"];
/// Length of an ordinary flight, s.
pub const ORDINARY_S: f64 = 30.0;

/// Rows of the table, and what they are made of.
struct Table<'a> {
    vehicle: &'a Vehicle,
    path: &'a str,
    args: &'a Args,
    /// What was measured, what was reached, of how many cases, and the goal.
    rows: Vec<[String; 4]>,
}

/// Runs the parts that were asked for (all, where none was named) and prints the table.
pub fn run(vehicle: &Vehicle, path: &str, args: &Args) -> Result<(), Box<dyn std::error::Error>> {
    if let Some(unknown) = args.parts.iter().find(|p| !PARTS.contains(&p.as_str())) {
        let known = PARTS.join(", ");
        return Err(format!("expected parts among {known}, found `{unknown}`: take one of them").into());
    }
    let wanted = |part: &str| args.parts.is_empty() || args.parts.iter().any(|p| p == part);
    let base = Case {
        hidden: vec![],
        seed: 0,
        noise: NoiseLevel::Fine,
        excitation: None,
        seconds: args.seconds,
        build: Build::usual(args.tolerance),
        inputs: Inputs::Commands,
        closure: false,
        tracked: true,
    };
    let mut table = Table { vehicle, path, args, rows: Vec::new() };
    for noise in LEVELS {
        let base = Case { noise, ..base.clone() };
        let level = format!("{noise:?}").to_lowercase();
        if wanted("single") {
            table.single(&level, &base)?;
        }
        if wanted("pairs") {
            table.pairs(&level, &base)?;
        }
        if wanted("none") {
            table.none(&level, &base)?;
        }
        if wanted("unlisted") {
            table.unlisted(&level, &base)?;
        }
        if wanted("formulas") {
            table.formulas(&level, &base)?;
        }
        if wanted("moments") {
            table.moments(&level, &base)?;
        }
        if wanted("steady") {
            table.steady(&level, &base)?;
        }
    }
    if wanted("ordinary") {
        for (name, excitation) in [
            ("Lissajous", Excitation::Lissajous),
            ("circle", Excitation::Circle),
            ("hover with yaw", Excitation::HoverYaw),
        ] {
            table.ordinary(name, excitation, &base)?;
        }
    }
    if wanted("time") {
        table.time(&base)?;
    }
    println!("\n| what | reached | cases | goal |\n|---|---|---|---|");
    for [what, reached, of, goal] in table.rows {
        println!("| {what} | {reached} | {of} | {goal} |");
    }
    Ok(())
}

/// Vehicles of the parts about moments.
fn craft(args: &Args) -> Vec<String> {
    if args.vehicles.is_empty() { vec!["quad".into()] } else { args.vehicles.clone() }
}

fn loaded(name: &str) -> Result<Vehicle, Box<dyn std::error::Error>> {
    Ok(Vehicle::load(format!("{}/tests/data/planted_{name}.toml", env!("CARGO_MANIFEST_DIR")))?)
}

/// The flights that were flown; says which were not, and refuses where none was.
fn counted(flown: moments::Tries) -> Result<Vec<moments::Tried>, Box<dyn std::error::Error>> {
    for why in &flown.not_flown {
        println!("left out, since it is no flight: {why}");
    }
    match flown.tried.is_empty() {
        true => Err("expected flights, found none that can be flown: take other seeds".into()),
        false => Ok(flown.tried),
    }
}

type Done = Result<(), Box<dyn std::error::Error>>;

impl Table<'_> {
    fn row(&mut self, what: &str, reached: String, of: usize, goal: &str) {
        self.rows.push([what.into(), reached, of.to_string(), goal.into()]);
    }

    /// Each effect with each seed, otherwise as `like`.
    fn over(&self, effects: &[&'static str], like: &Case) -> Vec<Case> {
        let seeds = self.args.first..self.args.first + self.args.seeds;
        let each = effects.iter().flat_map(|e| seeds.clone().map(move |seed| (*e, seed)));
        each.map(|(e, seed)| Case { hidden: vec![e], seed, ..like.clone() }).collect()
    }

    /// One effect of the list.
    fn single(&mut self, level: &str, base: &Case) -> Done {
        let like = Case { closure: true, ..base.clone() };
        let out = all(&self.over(HIDDEN, &like), self.vehicle, self.path)?;
        let n = out.len();
        self.row(&format!("one effect, {level}: first"), share(&out, Outcome::first_right), n, "≥ 97 %");
        self.row(&format!("one effect, {level}: it and nothing else"), share(&out, Outcome::exact), n, "");
        let (inside, of) = out.iter().map(Outcome::intervals).fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        self.row(
            &format!("intervals of 95 % that hold the truth, {level}"),
            percent(inside, of),
            of,
            "90–99 %",
        );
        self.closures(level, &out);
        confusion(&out);
        misses(&out);
        Ok(())
    }

    /// How much error is left after adding what was found.
    fn closures(&mut self, level: &str, out: &[Outcome]) {
        let mut closures: Vec<f64> = out.iter().filter_map(|o| o.closure).collect();
        closures.sort_by(f64::total_cmp);
        let at = |q: f64| closures.get((q * (closures.len() as f64 - 1.0)) as usize).copied();
        if let (Some(median), Some(worst)) = (at(0.5), at(0.9)) {
            let text = format!("{median:.3} (9 of 10 below {worst:.3})");
            self.row(
                &format!("error after adding, over that of the true values, {level}"),
                text,
                closures.len(),
                "≤ 1.05",
            );
        }
    }

    /// Two effects.
    fn pairs(&mut self, level: &str, base: &Case) -> Done {
        let out = all(&pairs(self.args.pairs, base), self.vehicle, self.path)?;
        self.row(
            &format!("two effects, {level}: both and nothing else"),
            share(&out, Outcome::group_right),
            out.len(),
            "≥ 90 %",
        );
        self.row(&format!("two effects, {level}: both"), share(&out, Outcome::in_a_group), out.len(), "");
        Ok(())
    }

    /// Nothing hidden.
    fn none(&mut self, level: &str, base: &Case) -> Done {
        let many = self.args.first..self.args.first + 4 * self.args.seeds;
        let cases: Vec<Case> = many.map(|seed| Case { seed, ..base.clone() }).collect();
        let out = all(&cases, self.vehicle, self.path)?;
        self.row(
            &format!("nothing hidden, {level}: nothing missing"),
            share(&out, Outcome::silent),
            out.len(),
            "≥ 98 %",
        );
        Ok(())
    }

    /// An effect that is not in the list.
    fn unlisted(&mut self, level: &str, base: &Case) -> Done {
        let out = all(&self.over(UNLISTED, base), self.vehicle, self.path)?;
        self.row(
            &format!("not in the list, {level}: unexplained"),
            share(&out, Outcome::exact),
            out.len(),
            "≥ 90 %",
        );
        Ok(())
    }

    /// Formulas for what is in no list, and none where nothing is missing.
    fn formulas(&mut self, level: &str, base: &Case) -> Done {
        let seeds = self.args.first..self.args.first + self.args.seeds;
        let out =
            formulas::run(seeds, base, self.vehicle, self.path, self.args).map_err(|e| e.to_string())?;
        let n = out.len();
        let part = |of: &dyn Fn(&formulas::Tried) -> bool| percent(out.iter().filter(|t| of(t)).count(), n);
        let kinds = formulas::kinds(self.args).len();
        self.row(
            &format!("{kinds} effects in no list, {level}: a formula"),
            part(&|t| t.formula.is_some()),
            n,
            "",
        );
        let name = format!("{kinds} effects in no list, {level}: takes 80 % of what the truth would");
        self.row(&name, part(&|t| t.gained() >= formulas::ENOUGH), n, "≥ 80 %");
        let name = format!("{kinds} effects in no list, {level}: an effect of the list named, certain");
        self.row(&name, part(&|t| t.wrong), n, "≤ 2 %");
        self.row(
            &format!("{kinds} effects in no list, {level}: unseen error raised"),
            part(&|t| t.raised()),
            n,
            "0",
        );
        let many = self.args.first..self.args.first + 4 * self.args.seeds;
        let none = formulas::nothing(many, base, self.vehicle, self.path).map_err(|e| e.to_string())?;
        let found = none.iter().filter(|f| f.is_some()).count();
        self.row(
            &format!("nothing hidden, {level}: a formula"),
            percent(found, none.len()),
            none.len(),
            "≤ 1 %",
        );
        Ok(())
    }

    /// Effects that come in mid-flight.
    fn moments(&mut self, level: &str, base: &Case) -> Done {
        for name in craft(self.args) {
            let vehicle = loaded(&name)?;
            let seeds = self.args.first..self.args.first + self.args.seeds;
            let flown = moments::changed(seeds, base, &vehicle, self.args).map_err(|e| e.to_string())?;
            let out = counted(flown)?;
            let n = out.len();
            let part =
                |of: &dyn Fn(&moments::Tried) -> bool| percent(out.iter().filter(|t| of(t)).count(), n);
            let row = |what: &str| format!("{name}, {level}: {what}");
            let rows = [
                (row("moment found within 0.3 s"), part(&|t| t.found()), "≥ 90 %"),
                (row("and named, alone or with look-alikes"), part(&|t| t.named()), ""),
                (row("interval of 95 % holds it"), part(&|t| t.held()), ""),
                (row("another moment beside it"), part(&|t| t.more() > 0), ""),
            ];
            for (what, reached, goal) in rows {
                self.row(&what, reached, n, goal);
            }
        }
        Ok(())
    }

    /// Flights in which nothing changes, with nothing hidden or an effect from the beginning on.
    fn steady(&mut self, level: &str, base: &Case) -> Done {
        for name in craft(self.args) {
            let vehicle = loaded(&name)?;
            let seeds = self.args.first..self.args.first + self.args.seeds;
            let effects: Vec<&'static str> = match self.args.kinds.is_empty() {
                true => core::iter::once("none").chain(HIDDEN.iter().copied()).collect(),
                false => self.args.kinds.iter().map(|k| id(k)).collect::<Result<_, _>>()?,
            };
            let flown =
                moments::steady(&effects, seeds, base, &vehicle, self.args).map_err(|e| e.to_string())?;
            let out = counted(flown)?;
            let quiet = out.iter().filter(|t| t.more() == 0).count();
            let what = format!("{name}, {level}: no moment in a steady flight");
            self.row(&what, percent(quiet, out.len()), out.len(), "≥ 98 %");
        }
        Ok(())
    }

    /// Flights that were not flown to find anything.
    fn ordinary(&mut self, name: &str, excitation: Excitation, base: &Case) -> Done {
        let cases: Vec<Case> = HIDDEN
            .iter()
            .enumerate()
            .map(|(i, e)| Case {
                hidden: vec![e],
                seed: self.args.first + i as u64 % self.args.seeds.max(1),
                excitation: Some(excitation),
                seconds: ORDINARY_S,
                ..base.clone()
            })
            .collect();
        let out = all(&cases, self.vehicle, self.path)?;
        let n = out.len();
        self.row(&format!("{name}: named, or in the named group"), share(&out, Outcome::in_a_group), n, "");
        self.row(&format!("{name}: nothing to be seen"), share(&out, Outcome::silent), n, "");
        self.row(
            &format!("{name}: a wrong name without doubt"),
            share(&out, Outcome::confidently_wrong),
            n,
            "≤ 5 %",
        );
        let told = |o: &Outcome| o.in_a_group() || (o.silent() && o.could_not_show());
        self.row(
            &format!("{name}: in the group, or among what the flight could not show"),
            share(&out, told),
            n,
            "≥ 95 %",
        );
        let open: Vec<&Outcome> = out.iter().filter(|o| !(o.exact() && o.certain())).collect();
        let next = advised(&open, self.vehicle)?;
        let flown: Vec<Outcome> = next.into_iter().flatten().collect();
        let text = format!(
            "{} of {} advised",
            percent(flown.iter().filter(|o| o.exact()).count(), open.len()),
            flown.len()
        );
        self.row(
            &format!("{name}, not decided: right after the flight that is advised"),
            text,
            open.len(),
            "",
        );
        let seen: Vec<Outcome> = out.into_iter().filter(|o| !o.silent()).collect();
        self.row(
            &format!("{name}: in the group, where anything is seen"),
            share(&seen, Outcome::in_a_group),
            seen.len(),
            "≥ 95 %",
        );
        Ok(())
    }

    /// How long it takes.
    fn time(&mut self, base: &Case) -> Done {
        let case = Case { hidden: vec!["rotor_drag"], seconds: 60.0, ..base.clone() };
        let (mut took, mut compared) = (Vec::new(), Vec::new());
        for seed in 0..5 {
            let case = Case { seed, ..case.clone() };
            took.push(case.run(self.vehicle, self.path).map_err(|e| e.to_string())?.took_s);
            compared.push(case.compare(self.vehicle).map_err(|e| e.to_string())?);
        }
        took.sort_by(f64::total_cmp);
        compared.sort_by(f64::total_cmp);
        let what = "60 s at 240 Hz, all candidates, with reading: median time";
        self.row(what, format!("{:.1} s", took[2]), 5, "≤ 5 s on 2 cores");
        let what = "60 s at 240 Hz, compare, without reading: median time";
        self.row(what, format!("{:.2} s", compared[2]), 5, "≤ 0.5 s on 2 cores");
        Ok(())
    }
}

/// All cases, several at a time; prints those that are not exact.
fn all(cases: &[Case], vehicle: &Vehicle, path: &str) -> Result<Vec<Outcome>, Box<dyn std::error::Error>> {
    let out: Result<Vec<Outcome>, _> = cases
        .par_iter()
        .map(|case| {
            let outcome = case.run(vehicle, path)?;
            if !outcome.exact() {
                println!("{}", outcome.line());
            }
            Ok(outcome)
        })
        .collect();
    out.map_err(|e: Box<dyn std::error::Error + Send + Sync>| e.to_string().into())
}

/// What is said after the flights that verdicts advise.
fn advised(
    cases: &[&Outcome],
    vehicle: &Vehicle,
) -> Result<Vec<Option<Outcome>>, Box<dyn std::error::Error>> {
    let out: Result<Vec<_>, Box<dyn std::error::Error + Send + Sync>> = cases
        .par_iter()
        .map(|o| {
            let next = o.case.advised(o, vehicle)?;
            let words = next.as_ref().map_or_else(|| "no manoeuvre is advised".into(), Outcome::line);
            println!("after {}: {words}", o.verdict.next_flight().join(" + "));
            if next.as_ref().is_some_and(|n| !n.exact()) {
                println!("    before: {}", o.line());
            }
            Ok(next)
        })
        .collect();
    out.map_err(|e| e.to_string().into())
}

fn share(out: &[Outcome], right: impl Fn(&Outcome) -> bool) -> String {
    percent(out.iter().filter(|o| right(o)).count(), out.len())
}

pub fn percent(part: usize, of: usize) -> String {
    format!("{:.1} %", 100.0 * part as f64 / of.max(1) as f64)
}

/// Pairs of different effects that one kind of flight shows, drawn evenly.
fn pairs(n: u64, like: &Case) -> Vec<Case> {
    let usual: Vec<&'static str> =
        HIDDEN.iter().copied().filter(|e| Excitation::exciting(e) == Excitation::MultiSine).collect();
    (0..n)
        .map(|i| {
            let mut draw = planted_stream(i, 0, "pair");
            let mut one = || usual[draw.below(usual.len() as u64) as usize];
            let first = one();
            let mut second = one();
            while second == first {
                second = one();
            }
            Case { hidden: vec![first, second], seed: i, ..like.clone() }
        })
        .collect()
}

/// Prints how far parameters are from the truth, where that is beyond their interval.
fn misses(out: &[Outcome]) {
    let mut beyond: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (name, sigmas) in out.iter().flat_map(Outcome::misses) {
        beyond.entry(name).or_default().push(sigmas);
    }
    println!("| parameter | flights | beyond its interval | farthest, σ |\n|---|---|---|---|");
    for (name, all) in beyond {
        let outside = all.iter().filter(|s| **s > 1.96).count();
        let farthest = all.iter().copied().fold(0.0, f64::max);
        if outside > 0 {
            println!("| {name} | {} | {outside} | {farthest:.1} |", all.len());
        }
    }
    println!();
}

/// Prints what was taken for what.
fn confusion(out: &[Outcome]) {
    let mut taken: BTreeMap<(String, String), usize> = BTreeMap::new();
    for o in out.iter().filter(|o| !o.exact()) {
        let said = if o.found().is_empty() { "nothing".to_string() } else { o.found().join(" + ") };
        *taken.entry((o.hidden(), said)).or_default() += 1;
    }
    println!("\n| hidden | taken for | times |\n|---|---|---|");
    for ((hidden, said), times) in taken {
        println!("| {hidden} | {said} | {times} |");
    }
    println!();
}
