//! `propwash identify`: parameters of a model from a flight log.

use super::drones::find;
use super::{print, print_json};
use crate::cli::args::{IdentifyArgs, ModelArg};
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::flight::FlightLog;
use crate::gap::attitude_model::{Options, identify};
use crate::{Error, Result};
use serde_json::json;
use std::time::{SystemTime, UNIX_EPOCH};

/// Runs the command.
pub fn run(args: &IdentifyArgs) -> Result<Outcome> {
    let ModelArg::Attitude = args.model;
    if let Some(out) = args.out.as_ref().filter(|out| out.extension().is_none_or(|e| e != "toml")) {
        return Err(Error::Usage {
            flag: "--out",
            expected: "a file name that ends in .toml".into(),
            got: out.display().to_string(),
        });
    }
    output::check(&[("--out", args.out.as_deref())], args.force)?;
    let vehicle = find(&args.vehicle)?;
    let (log, report) = FlightLog::open(&args.file, args.mapping.as_deref())?;
    for warning in report.warnings() {
        warn(&warning);
    }
    let found = identify(&log, &vehicle, &Options { dynamics: args.dynamics.clone() })?;
    let better = match &args.out {
        Some(out) => Some((out, found.vehicle_for_any_folder(&vehicle, &today())?)),
        None => None,
    };
    if args.json {
        print_json(&json!(found))?;
    } else {
        print(&found)?;
    }
    if let Some((out, better)) = better {
        output::write("--out", out, better.to_toml().as_bytes(), args.force)?;
        if !args.json {
            print(format_args!("\nwrote {}", out.display()))?;
        }
    }
    Ok(Outcome::Fine)
}

/// The day in UTC, year-month-day.
fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    date((seconds / 86_400) as i64)
}

/// Year-month-day of a day counted from 1970-01-01. (Hinnant, "chrono-compatible low-level date algorithms", 2013.)
fn date(days: i64) -> String {
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::date;

    #[test]
    fn days_become_dates_over_leap_years() {
        assert_eq!(date(0), "1970-01-01");
        assert_eq!(date(11_016), "2000-02-29");
        assert_eq!(date(20_512), "2026-02-28");
        assert_eq!(date(20_513), "2026-03-01");
    }
}
