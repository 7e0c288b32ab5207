//! `propwash sitl`: a flight stack flies a simulated vehicle.

use super::{io_error, print, print_json};
use crate::arena::{DroneConfig, SceneConfig, VehicleSource};
use crate::autopilot::earth::Home;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::output;
use crate::cli::sitl_args::SitlArgs;
use crate::sitl::{Company, SensorNoise, Server, SitlConfig, SitlError};
use crate::{Error, Result};
use serde_json::json;
use std::sync::atomic::Ordering;

/// Runs the command.
pub fn run(args: &SitlArgs) -> Result<Outcome> {
    output::check(&[("--record", args.record.as_deref())], args.force)?;
    let mut server = Server::bind(config(args)?)?;
    begin(args, &server)?;
    let wished = interrupt::flag();
    let stop = || wished.load(Ordering::Relaxed);
    let mut say = |words: &str| eprintln!("{words}");
    let mut company = Company { stop: &stop, say: &mut say };
    let ended = loop {
        if args.seconds.is_some_and(|s| server.time_s() >= s) {
            break None;
        }
        match server.step(&mut company) {
            Ok(()) => {}
            Err(SitlError::Interrupted) => break None,
            // The usual end of a session; everything was fine until then.
            Err(e @ SitlError::Closed { .. }) => {
                eprintln!("{e}");
                break None;
            }
            Err(e) => break Some(e),
        }
    };
    server.finish()?;
    match ended {
        Some(e) => Err(e.into()),
        None => report(args, &server).map(|()| Outcome::Fine),
    }
}

/// The description that the flags make.
fn config(args: &SitlArgs) -> Result<SitlConfig> {
    let mut config = SitlConfig {
        stack: args.stack.into(),
        drone: DroneConfig { vehicle: VehicleSource::Named(args.vehicle.clone()), ..DroneConfig::default() },
        scene: args.scene.clone().map(|path| SceneConfig::Files(vec![path])),
        port: args.port,
        rate_hz: args.rate,
        substeps: args.substeps,
        throttle: args.throttle.map(Into::into),
        max_speed_rad_s: args.max_speed,
        motors: args.motors.clone(),
        sensors: args.sensor.clone(),
        again: args.again,
        record: args.record.clone(),
        replace: args.force,
        ..SitlConfig::default()
    };
    fn put<T>(to: &mut T, value: Option<T>) {
        if let Some(value) = value {
            *to = value;
        }
    }
    put(&mut config.start_m, args.start);
    put(&mut config.heading_deg, args.heading);
    put(&mut config.address, args.address);
    put(&mut config.firmware, args.firmware);
    put(&mut config.seed, args.seed);
    put(&mut config.speed, args.speed);
    put(&mut config.timeout_s, args.timeout);
    if let Some([lat_deg, lon_deg, alt_m]) = args.home {
        config.home = Home { lat_deg, lon_deg, alt_m };
    }
    if let Some(pulses) = &args.pulses {
        config.pulses_us = pulses[..].try_into().map_err(|_| Error::Usage {
            flag: "--pulses",
            expected: "two pulse widths, such as 1100,1900".into(),
            got: format!("{} of them", pulses.len()),
        })?;
    }
    config.noise = match &args.noise {
        _ if args.no_noise => Some(SensorNoise::default()),
        None => None,
        Some(path) => {
            let text = crate::flight::files::read_text(path).map_err(io_error(path))?;
            Some(crate::arena::read_text(&text).map_err(|e| e.in_file(path))?)
        }
    };
    Ok(config)
}

/// Says what there is before anything is waited for.
fn begin(args: &SitlArgs, server: &Server) -> Result<()> {
    let config = server.config();
    let (stack, address) = (config.stack.title(), server.address()?);
    let order = server.motors().iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let words = format!(
        "{stack} flies {} at {address}; its motors drive rotors {order}; Ctrl-C ends it",
        args.vehicle
    );
    // In JSON the summary alone goes to standard output.
    if args.json {
        eprintln!("{words}");
        return Ok(());
    }
    print(words)
}

/// Says what happened.
fn report(args: &SitlArgs, server: &Server) -> Result<()> {
    let (traffic, truth) = (server.traffic(), server.truth());
    let hits = server.touches().iter().filter(|t| !t.stands).count();
    if args.json {
        return print_json(&json!({
            "stack": server.config().stack.name(), "seconds": server.time_s(), "rate_hz": server.rate_hz(),
            "pos_m": truth.pos_m, "vel_m_s": truth.vel_m_s, "quat_xyzw": truth.quat_xyzw,
            "commands": traffic.commands, "other_messages": traffic.others, "malformed": traffic.malformed,
            "stale": traffic.stale, "lost": traffic.lost, "restarts": traffic.restarts,
            "landings": server.touches().len() - hits, "hits": hits,
        }));
    }
    let [x, y, z] = truth.pos_m;
    print(format_args!(
        "flew {:.3} s at {} Hz by {} commands; {x:.2} m north, {:.2} m east, {z:.2} m up of the start",
        server.time_s(),
        server.rate_hz(),
        traffic.commands,
        // Not −y: nothing flown is no minus zero.
        0.0 - y
    ))?;
    if traffic.malformed + traffic.lost + traffic.stale + traffic.restarts > 0 {
        print(format_args!(
            "malformed: {}, lost: {}, stale: {}, restarts: {}",
            traffic.malformed, traffic.lost, traffic.stale, traffic.restarts
        ))?;
    }
    for touch in server.touches().iter().filter(|t| !t.stands) {
        print(format_args!("at {:.3} s it hit {} at {:.1} m/s", touch.time_s, touch.what, touch.speed_m_s))?;
    }
    Ok(())
}
