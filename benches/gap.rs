//! Hidden effects: how often the diagnosis names them, and in what time. `cargo bench --bench gap -- --help`.

#[path = "../tests/common/planted/mod.rs"]
mod planted;

use clap::Parser;
use planted::{CEILING_Z_M, Excitation, HIDDEN, NoiseLevel, Plan, fly, id};
use propwash::flight::FlightLog;
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::{Options, Track};
use propwash::vehicle::Vehicle;
use std::time::Instant;

/// Plants effects in simulated flights and asks the diagnosis what is missing.
#[derive(Parser)]
struct Args {
    /// Effects, several at once joined by `+`; `all` for each alone, `none` for nothing.
    #[arg(long, value_delimiter = ',', default_value = "all")]
    effects: Vec<String>,
    /// Seeds per effect.
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Length of a flight, s.
    #[arg(long, default_value_t = 50.0)]
    seconds: f64,
    /// Rough sensors and air.
    #[arg(long)]
    rough: bool,
    /// Track: multi-sine, lissajous, circle, hover-yaw, waypoints.
    #[arg(long)]
    excitation: Option<String>,
    /// Says more.
    #[arg(long, short)]
    verbose: bool,
    /// Width of the manufacturing tolerances.
    #[arg(long, default_value_t = 1.0)]
    tolerance: f64,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let vehicle = Vehicle::load(path)?;
    let mut cases: Vec<Vec<&'static str>> = Vec::new();
    for name in &args.effects {
        match name.as_str() {
            "all" => cases.extend(HIDDEN.iter().map(|h| vec![*h])),
            "none" => cases.push(vec![]),
            several => cases.push(several.split('+').map(id).collect::<Result<_, _>>()?),
        }
    }
    let folder = tempfile::tempdir()?;
    let (mut right, mut first, mut all) = (0, 0, 0);
    for case in &cases {
        for seed in args.first..args.first + args.seeds {
            let mut plan = Plan::exciting(&vehicle, case, args.seconds, seed);
            plan.tolerance = args.tolerance;
            if args.rough {
                plan.noise = NoiseLevel::Rough;
            }
            if let Some(name) = &args.excitation {
                plan.excitation = match name.as_str() {
                    "lissajous" => Excitation::Lissajous,
                    "circle" => Excitation::Circle,
                    "hover-yaw" => Excitation::HoverYaw,
                    "waypoints" => Excitation::Waypoints,
                    _ => Excitation::MultiSine,
                };
            }
            let flight = fly(&plan)?;
            let file = folder.path().join("flight.csv");
            flight.write(&file)?;
            let begin = Instant::now();
            let log = FlightLog::load(&file, None)?;
            let loaded = begin.elapsed().as_secs_f64();
            let ceiling = plan.excitation == Excitation::NearCeiling;
            let options = Options { ceiling_z_m: ceiling.then_some(CEILING_Z_M), ..Options::default() };
            let track = Track::new(log, &vehicle, &options)?;
            let result = diagnose(&[track], &vehicle, &Settings::default())?;
            let took = begin.elapsed().as_secs_f64();
            let verdict = &result.verdict;
            let names: Vec<&str> = verdict.findings.iter().map(|f| f.id.as_str()).collect();
            let mut wanted = case.clone();
            let mut found = names.clone();
            wanted.sort_unstable();
            found.sort_unstable();
            all += 1;
            right += usize::from(wanted == found);
            first += usize::from(names.first().copied() == case.first().copied());
            println!(
                "{} {:<28} seed {seed} {took:>5.1} s (read {loaded:.1})  φ {:>5.2} force {:.3} torque {:.2}  {}",
                if wanted == found { "ok " } else { "BAD" },
                if case.is_empty() { "none".into() } else { case.join("+") },
                verdict.dispersion,
                verdict.remainder.force_m_s2,
                verdict.remainder.torque_rad_s2,
                verdict.verdict,
            );
            if args.verbose {
                for f in &verdict.findings {
                    println!(
                        "      {} {:.0} nats, removes {:.1} %",
                        f.id,
                        f.evidence_nats,
                        100.0 * f.removed_share
                    );
                    for p in &f.parameters {
                        println!(
                            "        {} = {:.5} ± {:.5} {} (filed {})",
                            p.name, p.value, p.sigma, p.unit, p.filed
                        );
                    }
                }
                for planted in &flight.truth.hidden {
                    println!(
                        "      truth {} {:?} filed {:?} size {}",
                        planted.id, planted.parameters, planted.filed, flight.truth.size
                    );
                }
                for (id, nats) in verdict.singles.iter().take(6) {
                    println!("      alone {id} {nats:.0}");
                }
                for c in &verdict.calibration {
                    println!(
                        "      calibration {} {} {:.5} ± {:.5} (filed {})",
                        c.id, c.parameter.name, c.parameter.value, c.parameter.sigma, c.parameter.filed
                    );
                }
                for t in &verdict.remainder.terms {
                    println!(
                        "      term {} ~ {} {:.3} ± {:.3} share {:.2}",
                        t.on, t.variable, t.coefficient, t.sigma, t.explained_share
                    );
                }
                for w in &verdict.warnings {
                    println!("      {w}");
                }
            }
        }
    }
    println!("{right} of {all} exact, first right {first}");
    Ok(())
}
