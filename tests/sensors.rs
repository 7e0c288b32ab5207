//! Sensors on the drones of an arena: those that are built in against plain geometry, and one of a user's own.

use std::sync::Arc;

use propwash::arena::{Arena, SceneConfig, SimConfig};
use propwash::math::quat;
use propwash::physics::controllers::ControlMode;
use propwash::physics::rigid_body::State;
use propwash::scene::Pose;
use propwash::sense::sensors::{InertialSensor, Lidar, OpticalFlow};
use propwash::sense::{ImuNoise, Moment, SenseError, Sensor, SensorChannel};

/// A floor at height 0 and a wall whose face is at x = 3 m.
const HALL: &str = "<mujoco><worldbody><geom type='plane' size='0 0 1'/>\
    <geom type='box' size='0.5 20 20' pos='3.5 0 0'/></worldbody></mujoco>";

fn hall(n_worlds: usize, first_world: u64) -> SimConfig {
    let mut config = SimConfig { scene: Some(SceneConfig::Xml(HALL.into())), ..SimConfig::default() };
    config.options.n_worlds = n_worlds;
    config.options.first_world = first_world;
    config.options.seed = 7;
    config.options.control = ControlMode::BodyRate;
    config
}

/// Drones at height 2 m with this state otherwise.
fn arena(config: &SimConfig, state: State<f64>) -> Arena<f64> {
    let mut arena = Arena::from_config(config).unwrap();
    for world in 0..config.options.n_worlds {
        arena.set_initial(world, 0, state).unwrap();
    }
    arena.reset(None).unwrap();
    let weight = arena.sim().drone(0, 0).hover_thrust();
    arena.set_command(&[0.0, 0.0, 0.0, weight].repeat(config.options.n_worlds)).unwrap();
    arena
}

fn high() -> State<f64> {
    State { pos: [0.0, 0.0, 2.0], ..State::rest() }
}

#[test]
fn a_lidar_measures_the_wall_and_the_floor_along_its_rays() {
    let mut arena = arena(&hall(1, 0), high());
    let mount = Pose::new([0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
    let beam = arena.add_sensor(Arc::new(Lidar::beam("front", mount, (10.0, 0.0)).unwrap())).unwrap();
    let down = 0.5f64;
    let rings = Lidar::rings("lidar", (2, 4), [-down, down], Pose::default(), (5.0, 0.0)).unwrap();
    let lidar = arena.add_sensor(Arc::new(rings)).unwrap();
    arena.sample(beam).unwrap();
    arena.sample(lidar).unwrap();
    assert!((arena.samples(beam, "range").unwrap()[0] - 2.9).abs() < 1e-5);
    assert_eq!(arena.sensor_channels(lidar).unwrap(), [SensorChannel::new("range", "m", &[2, 4])]);
    let ranges = arena.samples(lidar, "range").unwrap();
    let (wall, floor) = (3.0 / down.cos(), 2.0 / down.sin());
    // Forward it is the wall; to the left, behind and to the right the floor, or nothing within reach.
    let expected = [wall, floor, floor, floor, wall, 5.0, 5.0, 5.0];
    for (found, expected) in ranges.iter().zip(expected) {
        assert!((f64::from(*found) - expected).abs() < 1e-4, "{ranges:?}");
    }
    // Turned to the left and rolled, the beam looks past the wall.
    let turned = quat::exp([0.0, 0.0, core::f64::consts::FRAC_PI_2]);
    let mut beside = self::arena(&hall(1, 0), State { quat: turned, ..high() });
    let beam = beside.add_sensor(Arc::new(Lidar::beam("front", mount, (10.0, 0.0)).unwrap())).unwrap();
    beside.sample(beam).unwrap();
    assert_eq!(beside.samples(beam, "range").unwrap(), [10.0]);
}

#[test]
fn flow_is_speed_over_distance_less_the_turning_of_the_drone() {
    let moving = State { vel: [0.6, -0.4, 0.0], ang_vel: [0.3, 0.2, 0.1], ..high() };
    let mut arena = arena(&hall(1, 0), moving);
    let flow = arena.add_sensor(Arc::new(OpticalFlow::down("flow", 4.0, 0.0).unwrap())).unwrap();
    arena.sample(flow).unwrap();
    let found = arena.samples(flow, "flow").unwrap();
    // The sensor's y axis is the body's y, its z axis the body's x.
    let expected = [0.6 / 2.0 - 0.2, 0.4 / 2.0 - 0.3];
    for k in 0..2 {
        assert!((f64::from(found[k]) - expected[k]).abs() < 1e-5, "{found:?} {expected:?}");
    }
    assert_eq!(arena.samples(flow, "distance").unwrap(), [2.0]);
    let far = OpticalFlow::down("far", 1.5, 0.0).unwrap();
    let far = arena.add_sensor(Arc::new(far)).unwrap();
    arena.sample(far).unwrap();
    assert_eq!(arena.samples(far, "valid").unwrap(), [0.0]);
    assert_eq!(arena.samples(far, "flow").unwrap(), [0.0, 0.0]);
}

fn imu() -> Arc<InertialSensor> {
    let noise = ImuNoise {
        accelerometer_density_m_s2_sqrt_hz: 2e-3,
        accelerometer_bias_m_s2: 0.05,
        accelerometer_walk_m_s2_sqrt_s: 0.02,
        gyroscope_density_rad_s_sqrt_hz: 1e-3,
        ..ImuNoise::default()
    };
    Arc::new(InertialSensor::new("imu", noise).unwrap())
}

#[test]
fn an_accelerometer_in_hover_reads_the_weight_without_a_scene_too() {
    let mut arena = arena(&SimConfig { scene: None, ..hall(1, 0) }, high());
    let exact = Arc::new(InertialSensor::new("imu", ImuNoise::default()).unwrap());
    let imu = arena.add_sensor(exact).unwrap();
    arena.step(50).unwrap();
    arena.sample(imu).unwrap();
    let force = arena.samples(imu, "accelerometer").unwrap();
    assert!((f64::from(force[2]) - 9.81).abs() < 0.02 && force[0].abs() < 1e-3, "{force:?}");
}

/// Samples of the noisy sensor in some worlds, (sample, world, 6).
fn readings(n_worlds: usize, first_world: u64, threads: usize) -> Vec<Vec<f32>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut arena = arena(&hall(n_worlds, first_world), high());
        let imu = arena.add_sensor(imu()).unwrap();
        (0..5)
            .map(|_| {
                arena.step(5).unwrap();
                arena.sample(imu).unwrap();
                let (a, g) =
                    (arena.samples(imu, "accelerometer").unwrap(), arena.samples(imu, "gyroscope").unwrap());
                a.chunks(3).zip(g.chunks(3)).flat_map(|(a, g)| [a, g].concat()).collect()
            })
            .collect()
    })
}

#[test]
fn samples_are_the_same_at_any_number_of_threads_and_however_worlds_are_split() {
    let whole = readings(6, 0, 1);
    assert_eq!(readings(6, 0, 4), whole);
    let (first, second) = (readings(2, 0, 2), readings(4, 2, 2));
    for (k, all) in whole.iter().enumerate() {
        assert_eq!([first[k].clone(), second[k].clone()].concat(), *all);
    }
    // Worlds differ, and so do samples.
    assert!(whole[0][..6] != whole[0][6..12] && whole[0] != whole[1]);
}

#[test]
fn what_sensors_remember_is_saved_restored_forked_and_forgotten_at_a_reset() {
    let mut arena = arena(&hall(2, 0), high());
    let imu = arena.add_sensor(imu()).unwrap();
    let sample = |arena: &mut Arena<f64>| {
        arena.step(10).unwrap();
        arena.sample(imu).unwrap();
        arena.samples(imu, "accelerometer").unwrap().to_vec()
    };
    sample(&mut arena);
    let saved = arena.save();
    let next = sample(&mut arena);
    arena.restore(&saved).unwrap();
    assert_eq!(sample(&mut arena), next);
    // The bias of world 0 becomes that of both; random numbers stay their own.
    arena.fork(0).unwrap();
    let values = arena.samples(imu, "accelerometer").unwrap();
    assert_eq!(values[..3], values[3..]);
    // A reset of one world begins it anew, with another bias, and leaves the other alone.
    arena.restore(&saved).unwrap();
    arena.reset(Some(&[true, false])).unwrap();
    let mixed = sample(&mut arena);
    assert!(mixed[..3] != next[..3] && mixed[3..] == next[3..], "{mixed:?} {next:?}");
    // Another set of sensors is refused, and nothing is changed.
    let mut bare = self::arena(&hall(2, 0), high());
    assert!(bare.restore(&saved).unwrap_err().to_string().contains("sensors"));
}

/// A sensor with whatever channels a test wants, that fails in one world.
struct Odd(Vec<SensorChannel>, bool);

impl Sensor for Odd {
    fn name(&self) -> &str {
        "odd"
    }
    fn channels(&self) -> Vec<SensorChannel> {
        self.0.clone()
    }
    fn sample(&self, at: &mut Moment, _: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        if self.1 {
            return Err(SenseError::Parameter { what: "it broke".into() });
        }
        out[0].fill(at.time_s as f32);
        Ok(())
    }
}

#[test]
fn sensors_that_cannot_be_are_refused_and_failures_name_their_worlds() {
    let mut arena = arena(&SimConfig { scene: None, ..hall(3, 0) }, high());
    let one = || SensorChannel::new("a", "1", &[2]);
    for channels in [vec![one(), one()], vec![SensorChannel::new("b", "1", &[0])]] {
        let error = arena.add_sensor(Arc::new(Odd(channels, false))).unwrap_err().to_string();
        assert!(error.contains("a name of its own"), "{error}");
    }
    let odd = arena.add_sensor(Arc::new(Odd(vec![one()], true))).unwrap();
    let error = arena.add_sensor(Arc::new(Odd(vec![one()], false))).unwrap_err().to_string();
    assert!(error.contains("no other sensor"), "{error}");
    let error = arena.sample(odd).unwrap_err().to_string();
    assert!(error.contains("3 of 3 worlds") && error.contains("it broke"), "{error}");
    assert!(
        arena.sample(5).is_err() && arena.samples(odd, "c").unwrap_err().to_string().contains("one of a")
    );
    // What needs a scene says so.
    let beam =
        arena.add_sensor(Arc::new(Lidar::beam("front", Pose::default(), (9.0, 0.0)).unwrap())).unwrap();
    assert!(arena.sample(beam).unwrap_err().to_string().contains("expected a scene"));
    assert!(Lidar::new("l", &[[1.0, 0.0, 0.0]], &[2], Pose::default(), (9.0, 0.0)).is_err());
    assert!(
        Lidar::beam("l", Pose::default(), (0.0, 0.0)).is_err() && OpticalFlow::down("f", -1.0, 0.0).is_err()
    );
}

#[test]
fn a_world_that_is_set_aside_keeps_its_last_sample() {
    let mut arena = arena(&SimConfig { scene: None, ..hall(2, 0) }, high());
    let clock = Odd(vec![SensorChannel::new("a", "1", &[])], false);
    let clock = arena.add_sensor(Arc::new(clock)).unwrap();
    arena.step(10).unwrap();
    arena.sample(clock).unwrap();
    arena.data_mut().vel[0] = f64::NAN;
    arena.step(10).unwrap();
    assert!(arena.sim().data.quarantine[0].is_some());
    arena.sample(clock).unwrap();
    assert_eq!(arena.samples(clock, "a").unwrap(), [0.02, 0.04]);
}
