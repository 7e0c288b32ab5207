//! Flight stacks in the loop, over sockets of this machine: a client of a few lines plays ArduPilot. Messages are held against pymavlink, and
//! whole flights against controllers in the clients, in `python/tests/test_sitl.py`.

use std::net::{SocketAddr, UdpSocket};
use std::thread;
use std::time::{Duration, Instant};

use propwash::arena::{DroneConfig, SceneConfig, VehicleSource};
use propwash::autopilot::Stack;
use propwash::sitl::{Company, Server, SitlConfig, SitlError, ThrottleLaw};
use propwash::vehicle::Vehicle;

/// The X500 for ArduPilot, at any free port and as fast as the client answers.
fn x500() -> SitlConfig {
    SitlConfig {
        stack: Stack::ArduPilot,
        port: Some(0),
        speed: 0.0,
        timeout_s: 20.0,
        ..SitlConfig::default()
    }
}

/// ArduPilot's packet of the same pulse for all four motors.
fn packet(rate_hz: u16, count: u32, pulse_us: u16) -> Vec<u8> {
    let mut out = [18_458u16.to_le_bytes(), rate_hz.to_le_bytes()].concat();
    out.extend(count.to_le_bytes());
    for i in 0..16 {
        out.extend((if i < 4 { pulse_us } else { 0 }).to_le_bytes());
    }
    out
}

/// Flies by pulses, one for each exchange; all answers.
fn fly(server: &mut Server, rate_hz: u16, pulses_us: Vec<u16>) -> Vec<String> {
    let (to, n) = (server.address().unwrap(), pulses_us.len());
    let client = thread::spawn(move || {
        let link = UdpSocket::bind((to.ip(), 0)).unwrap();
        link.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let mut buffer = [0; 2048];
        let turn = |(count, pulse): (usize, u16)| {
            link.send_to(&packet(rate_hz, count as u32, pulse), to).unwrap();
            let (n, from) = link.recv_from(&mut buffer).unwrap();
            assert_eq!(from, SocketAddr::new(to.ip(), to.port()));
            String::from_utf8(buffer[..n].to_vec()).unwrap()
        };
        pulses_us.into_iter().enumerate().map(turn).collect()
    });
    for _ in 0..n {
        server.step(&mut Company { stop: &|| false, say: &mut |_| () }).unwrap();
    }
    client.join().unwrap()
}

/// Number behind a name in an answer, of a list the one of this place.
fn number(line: &str, name: &str, at: usize) -> f64 {
    let rest = line.split_once(&format!("\"{name}\":")).unwrap().1.trim_start_matches('[');
    rest.split([',', ']', '}']).nth(at).unwrap().parse().unwrap()
}

#[test]
fn a_vehicle_takes_off_by_its_pulses_and_the_ground_carries_it_again() {
    let mut server = Server::bind(x500()).unwrap();
    let pulses = [vec![1200; 100], vec![1900; 200], vec![1000; 900]].concat();
    let lines = fly(&mut server, 400, pulses);
    // Too little to lift it: it stands, and reads its weight.
    assert!(lines[..100].iter().all(|l| number(l, "position", 2) == 0.0));
    assert!((number(&lines[50], "accel_body", 2) + 9.81).abs() < 1e-5);
    // Down is positive.
    let highest = lines.iter().map(|l| -number(l, "position", 2)).fold(0.0, f64::max);
    assert!(highest > 1.0, "{highest}");
    assert!(number(&lines[250], "velocity", 2) < -1.0);
    let last = lines.last().unwrap();
    assert_eq!((number(last, "position", 2).abs() < 1e-9, server.is_standing()), (true, true), "{last}");
    assert!(
        (number(last, "accel_body", 2) + 9.81).abs() < 1e-5
            && (number(last, "timestamp", 0) - 3.0).abs() < 1e-9
    );
    let touches = server.touches();
    assert!(touches.len() == 1 && touches[0].stands && touches[0].speed_m_s > 2.0, "{touches:?}");
    assert_eq!((server.rate_hz(), server.traffic().commands, server.traffic().restarts), (400, 1200, 0));
}

#[test]
fn the_same_pulses_give_the_same_answers_and_another_rate_the_same_flight() {
    let pulses = |n: usize| vec![1800; n];
    let first = fly(&mut Server::bind(x500()).unwrap(), 400, pulses(400));
    assert_eq!(first, fly(&mut Server::bind(x500()).unwrap(), 400, pulses(400)));
    // The rate that ArduPilot asks for is not the one of the start: the simulation is built anew.
    let fast = fly(&mut Server::bind(x500()).unwrap(), 1000, pulses(1000));
    let (a, b) = (number(&first[399], "position", 2), number(&fast[999], "position", 2));
    assert!((a - b).abs() < 0.02 * a.abs() && a < -1.0, "{a} {b}");
}

#[test]
fn a_wall_stops_a_vehicle_and_is_named() {
    let lid = "<mujoco><worldbody><geom type='plane' size='0 0 1'/><geom name='lid' type='box' size='2 2 .1' pos='0 0 1.5'/></worldbody></mujoco>";
    let mut server =
        Server::bind(SitlConfig { scene: Some(SceneConfig::Xml(lid.into())), ..x500() }).unwrap();
    let lines = fly(&mut server, 400, vec![1900; 600]);
    let hit = server.touches().iter().find(|t| !t.stands).expect("it flies into the lid");
    assert!(hit.what.contains("lid") && hit.speed_m_s > 1.0, "{hit:?}");
    assert!(lines.iter().all(|l| -number(l, "position", 2) < 1.4));
}

#[test]
fn a_wait_ends_when_that_is_wished_and_a_stack_that_stops_is_told_of() {
    let mut server = Server::bind(x500()).unwrap();
    let mut said = Vec::new();
    let outcome =
        server.step(&mut Company { stop: &|| true, say: &mut |words| said.push(words.to_string()) });
    assert!(matches!(outcome, Err(SitlError::Interrupted)));
    let mut server = Server::bind(SitlConfig { timeout_s: 0.2, ..x500() }).unwrap();
    fly(&mut server, 400, vec![1000; 3]);
    let began = Instant::now();
    let said = server.step(&mut Company { stop: &|| false, say: &mut |_| () }).unwrap_err().to_string();
    assert!(said.contains("ArduPilot") && said.contains("0.2 s") && said.contains("--model JSON"), "{said}");
    assert!(began.elapsed() < Duration::from_secs(5));
}

#[test]
fn a_command_means_what_the_law_says() {
    let rotor_after = |config: SitlConfig| {
        let mut server = Server::bind(config).unwrap();
        fly(&mut server, 400, vec![1500; 400]);
        server.rotor_vel().to_vec()
    };
    let full = 1191.0;
    let speed = rotor_after(x500());
    assert!(speed.iter().all(|v| (v - 0.5 * full).abs() < 2.0), "{speed:?}");
    let thrust = rotor_after(SitlConfig { throttle: Some(ThrottleLaw::Thrust), ..x500() });
    assert!(thrust.iter().all(|v| (v - 0.5f64.sqrt() * full).abs() < 2.0), "{thrust:?}");
    let own = rotor_after(SitlConfig { max_speed_rad_s: Some(800.0), ..x500() });
    assert!(own.iter().all(|v| (v - 400.0).abs() < 1.0), "{own:?}");
    // A file with a [throttle] is taken at its word: 8 V of 16 V, of which 1 V turns nothing.
    let text = Vehicle::builtin("hb_x500").unwrap().to_toml().replace(
        "[rates]",
        "[throttle]\noffset_v = 1.0\nback_emf_v_s_per_rad = 0.014\nload_v_s2_per_rad2 = 0.0\nnominal_v = 16.0\n[rates]",
    );
    let vehicle = VehicleSource::Text { name: "x500_throttle".into(), toml: text };
    let drone = DroneConfig { vehicle, ..DroneConfig::default() };
    let law = rotor_after(SitlConfig { drone: drone.clone(), ..x500() });
    assert!(law.iter().all(|v| (v - 7.0 / 0.014).abs() < 1.0), "{law:?}");
    let refused =
        Server::bind(SitlConfig { throttle: Some(ThrottleLaw::Vehicle), ..x500() }).unwrap_err().to_string();
    assert!(refused.contains("[throttle]") && refused.contains("hb_x500"), "{refused}");
}

#[test]
fn each_motor_drives_the_rotor_where_it_stands() {
    for motor in 0..4 {
        let mut server = Server::bind(x500()).unwrap();
        let order = server.motors().to_vec();
        assert_eq!(order, [0, 2, 3, 1]);
        let to = server.address().unwrap();
        let link = UdpSocket::bind((to.ip(), 0)).unwrap();
        let mut bytes = packet(400, 1, 1000);
        bytes[8 + 2 * motor..10 + 2 * motor].copy_from_slice(&1400u16.to_le_bytes());
        link.send_to(&bytes, to).unwrap();
        server.step(&mut Company { stop: &|| false, say: &mut |_| () }).unwrap();
        let turning: Vec<usize> = (0..4).filter(|i| server.rotor_vel()[*i] > 1.0).collect();
        assert_eq!(turning, [order[motor]]);
    }
}
