//! Hidden effects: how often the diagnosis names them, and in what time. `cargo xtask bench gap --help`.
//!
//! Without `--effects` it runs the whole table of docs/gap.md; with it, single cases with all that is known about them.

#[path = "gap/formulas.rs"]
mod formulas;
#[path = "gap/honest.rs"]
mod honest;
#[path = "gap/moments.rs"]
mod moments;
#[path = "../tests/common/planted/mod.rs"]
mod planted;
#[path = "gap/score.rs"]
mod score;
#[path = "gap/table.rs"]
mod table;

use clap::Parser;
use planted::{Build, Excitation, HIDDEN, Inputs, NoiseLevel, id};
use propwash::vehicle::Vehicle;
use score::{Case, Outcome};
use std::path::PathBuf;

/// Plants effects in simulated flights and asks the diagnosis what is missing.
#[derive(Parser)]
struct Args {
    /// Effects, several at once joined by `+`; `all` for each alone, `none` for nothing. Without it: the whole table.
    #[arg(long, value_delimiter = ',')]
    effects: Vec<String>,
    /// Seeds per effect.
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Length of an exciting flight, s.
    #[arg(long, default_value_t = 50.0)]
    seconds: f64,
    /// Rough sensors and air.
    #[arg(long)]
    rough: bool,
    /// What the pilot does, where it is not what shows the effects: multi-sine, lissajous, circle, hover-yaw, way-points …
    #[arg(long)]
    excitation: Option<String>,
    /// A load on a cable is not tracked.
    #[arg(long)]
    untracked: bool,
    /// Flies what each verdict advises, and asks again.
    #[arg(long)]
    advised: bool,
    /// Says all that is known of every case.
    #[arg(long, short)]
    verbose: bool,
    /// Width of the manufacturing tolerances.
    #[arg(long, default_value_t = 1.0)]
    tolerance: f64,
    /// Effects in no list for which formulas are searched, or that come in mid-flight or (steady) are there all the
    /// time; all where none is named.
    #[arg(long, value_delimiter = ',')]
    kinds: Vec<String>,
    /// Parts of the table to run: single, pairs, none, unlisted, formulas, moments, steady, ordinary, time.
    #[arg(long, value_delimiter = ',')]
    parts: Vec<String>,
    /// Runs the rows of realistic inputs in place of the table, on this half of seeds and vehicles: `develop` (even seeds) is
    /// for work on the finder, `report` (odd seeds, other vehicles) for the figures that are published.
    #[arg(long)]
    half: Option<String>,
    /// Inputs of those rows: commands, rotors, thrust; all where none is named. Also attitude, where a response can be
    /// identified.
    #[arg(long, value_delimiter = ',')]
    inputs: Vec<String>,
    /// Their noise levels: fine, rough, filtered; all where none is named.
    #[arg(long, value_delimiter = ',')]
    levels: Vec<String>,
    /// Their vehicles, by the names of tests/data/planted_NAME.toml; all of the half where none is named. Those of the parts moments and
    /// steady, too: quad where none is named.
    #[arg(long, value_delimiter = ',')]
    vehicles: Vec<String>,
    /// Cases per row, a sample that is always the same; all effects with all seeds where absent.
    #[arg(long)]
    sample: Option<usize>,
    /// Where to write one line of JSON per case of those rows.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Pairs of effects per noise level.
    #[arg(long, default_value_t = 50)]
    pairs: u64,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    if args.half.is_some() {
        return honest::run(&args);
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let vehicle = Vehicle::load(path)?;
    if args.effects.is_empty() {
        return table::run(&vehicle, path, &args);
    }
    let mut cases: Vec<Vec<&'static str>> = Vec::new();
    for name in &args.effects {
        match name.as_str() {
            "all" => cases.extend(HIDDEN.iter().map(|h| vec![*h])),
            "none" => cases.push(vec![]),
            several => cases.push(several.split('+').map(id).collect::<Result<_, _>>()?),
        }
    }
    let noise = if args.rough { NoiseLevel::Rough } else { NoiseLevel::Fine };
    let excitation = args.excitation.as_deref().map(Excitation::by_name).transpose()?;
    let (mut right, mut all) = (0, 0);
    for hidden in &cases {
        for seed in args.first..args.first + args.seeds {
            let case = Case {
                hidden: hidden.clone(),
                seed,
                noise,
                excitation,
                seconds: args.seconds,
                build: Build::usual(args.tolerance),
                inputs: Inputs::Commands,
                closure: false,
                tracked: !args.untracked,
            };
            let outcome = case.run(&vehicle, path).map_err(|e| e.to_string())?;
            all += 1;
            right += usize::from(outcome.exact());
            println!("{}", outcome.line());
            if args.verbose {
                tell(&outcome);
            }
            if args.advised
                && let Some(next) = case.advised(&outcome, &vehicle).map_err(|e| e.to_string())?
            {
                println!("after {}\n{}", outcome.verdict.next_flight().join(" + "), next.line());
                if args.verbose {
                    tell(&next);
                }
            }
        }
    }
    println!("{right} of {all} exact");
    Ok(())
}

/// All that is known of a case.
fn tell(outcome: &Outcome) {
    let verdict = &outcome.verdict;
    for f in &verdict.findings {
        let share = 100.0 * f.removed_share;
        println!("      {} {:.0} nats, removes {share:.1} %", f.id, f.evidence_nats);
        for p in &f.parameters {
            let (name, unit) = (&p.name, &p.unit);
            println!("        {name} = {:.5e} ± {:.1e} {unit} (filed {})", p.value, p.sigma, p.filed);
        }
    }
    for (name, value) in verdict.findings.iter().flat_map(|f| &f.set) {
        println!("        {name} = {value:.4e} (set)");
    }
    for planted in &outcome.truth.hidden {
        let (values, filed) = (&planted.parameters, &planted.filed);
        println!("      truth {} {values:?} filed {filed:?} size {}", planted.id, outcome.truth.size);
    }
    for (name, sigmas) in outcome.misses() {
        println!("      off {name} {sigmas:.1} sigma");
    }
    for (id, nats) in verdict.singles.iter().take(6) {
        println!("      alone {id} {nats:.0}");
    }
    for l in verdict.limits.iter().filter(|l| !l.visible || outcome.truth.hidden.iter().any(|h| h.id == l.id))
    {
        println!(
            "      hides {} {} up to {:?} {} ({:?} of usual)",
            l.id, l.parameter, l.size, l.unit, l.share
        );
    }
    for c in &verdict.calibration {
        let p = &c.parameter;
        println!("      calibration {} {} {:.5} ± {:.5} (filed {})", c.id, p.name, p.value, p.sigma, p.filed);
    }
    for t in &verdict.remainder.terms {
        let share = t.explained_share;
        println!(
            "      term {} ~ {} {:.3} ± {:.3} share {share:.2}",
            t.on, t.variable, t.coefficient, t.sigma
        );
    }
    println!("      {}", verdict.remainder.text);
    for line in verdict.advice.iter().map(|a| &a.text).chain(&verdict.warnings) {
        println!("      {line}");
    }
}
