//! Sensors on the drones of an arena: those that are built in against plain geometry, and one of a user's own.

use std::sync::Arc;

use propwash::arena::{Arena, SceneConfig, SimConfig};
use propwash::env::{Autoreset, Channel, Env, EnvConfig, EnvError, EpisodeStart, Outcome, Task, WorldView};
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
    arena.sample(beam, None).unwrap();
    arena.sample(lidar, None).unwrap();
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
    beside.sample(beam, None).unwrap();
    assert_eq!(beside.samples(beam, "range").unwrap(), [10.0]);
}

#[test]
fn flow_is_speed_over_distance_less_the_turning_of_the_drone() {
    let moving = State { vel: [0.6, -0.4, 0.0], ang_vel: [0.3, 0.2, 0.1], ..high() };
    let mut arena = arena(&hall(1, 0), moving);
    let flow = arena.add_sensor(Arc::new(OpticalFlow::down("flow", 4.0, 0.0).unwrap())).unwrap();
    arena.sample(flow, None).unwrap();
    let found = arena.samples(flow, "flow").unwrap();
    // The sensor's y axis is the body's y, its z axis the body's x.
    let expected = [0.6 / 2.0 - 0.2, 0.4 / 2.0 - 0.3];
    for k in 0..2 {
        assert!((f64::from(found[k]) - expected[k]).abs() < 1e-5, "{found:?} {expected:?}");
    }
    assert_eq!(arena.samples(flow, "distance").unwrap(), [2.0]);
    let far = OpticalFlow::down("far", 1.5, 0.0).unwrap();
    let far = arena.add_sensor(Arc::new(far)).unwrap();
    arena.sample(far, None).unwrap();
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
    arena.sample(imu, None).unwrap();
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
                arena.sample(imu, None).unwrap();
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
fn a_second_look_in_the_same_step_sees_the_same_and_changes_nothing() {
    let looked = |looks: usize| {
        let mut arena = arena(&hall(2, 0), high());
        let imu = arena.add_sensor(imu()).unwrap();
        let mut seen = Vec::new();
        for _ in 0..4 {
            let mut all: Vec<Vec<f32>> = (0..looks)
                .map(|_| {
                    arena.sample(imu, None).unwrap();
                    arena.samples(imu, "accelerometer").unwrap().to_vec()
                })
                .collect();
            all.dedup();
            assert_eq!(all.len(), 1);
            seen.extend(all);
            // From another arena's point of view nothing was looked at twice either.
            let saved = arena.save();
            arena.restore(&saved).unwrap();
            arena.sample(imu, None).unwrap();
            assert_eq!(arena.samples(imu, "accelerometer").unwrap(), seen[seen.len() - 1]);
            arena.step(3).unwrap();
        }
        seen
    };
    let once = looked(1);
    assert_eq!(looked(3), once);
    // Noise of a density is there at the reset itself.
    let mut quiet = arena(&hall(2, 0), high());
    let noise = ImuNoise { gyroscope_density_rad_s_sqrt_hz: 1e-3, ..ImuNoise::default() };
    let imu = quiet.add_sensor(Arc::new(InertialSensor::new("imu", noise).unwrap())).unwrap();
    quiet.sample(imu, None).unwrap();
    assert!(quiet.samples(imu, "gyroscope").unwrap().iter().all(|v| *v != 0.0));
}

#[test]
fn what_sensors_remember_is_saved_restored_forked_and_forgotten_at_a_reset() {
    let mut arena = arena(&hall(2, 0), high());
    let imu = arena.add_sensor(imu()).unwrap();
    let sample = |arena: &mut Arena<f64>| {
        arena.step(10).unwrap();
        arena.sample(imu, None).unwrap();
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
    let error = arena.sample(odd, None).unwrap_err().to_string();
    assert!(error.contains("3 of 3 worlds") && error.contains("it broke"), "{error}");
    assert!(
        arena.sample(5, None).is_err()
            && arena.samples(odd, "c").unwrap_err().to_string().contains("one of a")
    );
    // What needs a scene says so.
    let beam =
        arena.add_sensor(Arc::new(Lidar::beam("front", Pose::default(), (9.0, 0.0)).unwrap())).unwrap();
    assert!(arena.sample(beam, None).unwrap_err().to_string().contains("expected a scene"));
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
    arena.sample(clock, None).unwrap();
    arena.data_mut().vel[0] = f64::NAN;
    arena.step(10).unwrap();
    assert!(arena.sim().data.quarantine[0].is_some());
    arena.sample(clock, None).unwrap();
    assert_eq!(arena.samples(clock, "a").unwrap(), [0.02, 0.04]);
}

/// The description of a simulation in text.
fn described(text: &str) -> SimConfig {
    SimConfig::from_text(text).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn a_description_names_sensors_and_arenas_have_them() {
    let text = r#"
        scene = { xml = "<mujoco><worldbody><geom type='plane' size='0 0 1'/><geom type='box' size='0.5 20 20' pos='3.5 0 0'/></worldbody></mujoco>" }
        [[sensors]]
        kind = "imu"
        noise = { gyroscope_limit_rad_s = 5 }
        [[sensors]]
        kind = "lidar"
        rings = 2
        columns = 4
        elevation_rad = [-0.5, 0.5]
        [[sensors]]
        kind = "range_finder"
        name = "front"
        direction = [2, 0, 0]
        range_m = 10
        [[sensors]]
        kind = "optical_flow"
        [[sensors]]
        kind = "depth_camera"
        labels = true
        sample_hz = 20
        camera = { width = 4, height = 3, mount = { pos_m = [0.1, 0, 0] }, pinhole_px = [8, 8, 2, 1.5], range_m = [0.1, 8] }
    "#;
    let config = described(text);
    let again: SimConfig = described(&serde_json::to_string(&config).unwrap());
    assert_eq!(again, config, "infinite limits too are read back");
    let setup = config.load().unwrap();
    let rates: Vec<_> = setup.sensors().iter().map(|m| m.sample_hz).collect();
    assert_eq!(rates, [None, None, None, None, Some(20)]);
    let mut arena: Arena<f64> = setup.arena().unwrap();
    let names: Vec<&str> = arena.sensor_names().collect();
    assert_eq!(names, ["imu", "lidar", "front", "optical_flow", "depth_camera"]);
    arena.set_initial(0, 0, high()).unwrap();
    arena.reset(None).unwrap();
    for sensor in 0..arena.n_sensors() {
        arena.sample(sensor, None).unwrap();
    }
    let front = arena.sensor("front").unwrap();
    assert!((arena.samples(front, "range").unwrap()[0] - 3.0).abs() < 1e-5);
    let camera = arena.sensor("depth_camera").unwrap();
    let depth = arena.samples(camera, "depth").unwrap();
    // 0.1 m before the drone the wall is 2.9 m ahead, in each pixel that looks above the floor; the lowest row looks down by
    // 1 px of 8: it meets the wall first too, at 2.9/8 m below.
    assert!(depth.iter().all(|d| (d - 2.9).abs() < 1e-5), "{depth:?}");
    assert!(arena.samples(camera, "status").unwrap().iter().all(|s| *s == 0.0));
    assert!(arena.samples(camera, "geom_id").unwrap().iter().all(|g| *g == 1.0));
    assert!(arena.sensor("rear").unwrap_err().to_string().contains("one of imu, lidar, front"));
    assert!(arena.sample(0, Some(&[true, false])).unwrap_err().to_string().contains("1 worlds"));
}

#[test]
fn descriptions_of_sensors_that_cannot_be_are_refused_by_their_names() {
    let refused = |text: &str, words: &str| {
        let error = SimConfig::from_text(text).and_then(|c| c.load().map(|_| ())).unwrap_err().to_string();
        assert!(error.contains(words), "{text}: {error}");
    };
    refused("[[sensors]]\nkind = \"sonar\"", "unknown variant `sonar`");
    refused("[[sensors]]\nkind = \"imu\"\nrate = 5", "unknown field `rate`");
    refused("[[sensors]]\nkind = \"imu\"\nname = \"a b\"", "letters, digits and underscores");
    refused("[[sensors]]\nkind = \"imu\"\nsample_hz = 0", "1 to 500 Hz");
    refused("[[sensors]]\nkind = \"lidar\"", "without a scene");
    let hall = format!("scene = {{ xml = \"{HALL}\" }}\n");
    let hall = |rest: &str| hall.clone() + "[[sensors]]\n" + rest;
    refused(&hall("kind = \"lidar\"\nrings = 0"), "at least one ring");
    refused(&hall("kind = \"lidar\"\nelevation_rad = [1, 0]"), "elevations that rise");
    refused(&hall("kind = \"range_finder\"\ndirection = [0, 0, 0]"), "some length");
    refused(&hall("kind = \"range_finder\"\nrange_m = -1"), "greatest range above 0");
    refused(&hall("kind = \"optical_flow\"\nnoise_rad_s = -1"), "noise of at least 0");
    refused(&hall("kind = \"imu\"\nnoise = { gyroscope_bias_rad_s = -1 }"), "gyroscope");
    let both = "kind = \"depth_camera\"\ncamera = { fovy_deg = 50, pinhole_px = [8, 8, 2, 1.5] }";
    refused(&hall(both), "either a field of view or intrinsics");
    let twice = hall("kind = \"imu\"\n[[sensors]]\nkind = \"imu\"");
    let error = Arena::<f64>::from_config(&described(&twice)).unwrap_err().to_string();
    assert!(error.contains("no other sensor"), "{error}");
}

/// A task that is worth what the range finder ahead reads, and observes it twice.
struct Ahead;

impl Task for Ahead {
    fn name(&self) -> &str {
        "ahead"
    }
    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("twice", 1)]
    }
    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::Xml(HALL.into()), None)
    }
    fn memory_len(&self, _: usize) -> usize {
        0
    }
    fn begin(&self, at: &mut EpisodeStart) -> Result<(), EnvError> {
        at.starts[0] = propwash::env::Start::at([0.0, 0.0, 2.0]);
        Ok(())
    }
    fn judge(&self, view: &WorldView, _: &mut [f32], reward: &mut [f32]) -> Outcome {
        reward[0] = view.samples("front", "range").unwrap()[0];
        assert!(view.samples("front", "color").is_none() && view.samples("rear", "range").is_none());
        Outcome::Continue
    }
    fn observe(&self, view: &WorldView, _: &[f32], drone: usize, out: &mut [f32]) {
        out[0] = 2.0 * view.samples("front", "range").unwrap()[drone];
    }
}

fn ahead(sensor: &str, autoreset: Autoreset) -> Result<Env, EnvError> {
    let mut config = EnvConfig::from_text(&format!("n_worlds = 3\n[[sensors]]\n{sensor}")).unwrap();
    (config.autoreset, config.max_episode_s) = (autoreset, 0.1);
    Env::with_task(config, Arc::new(Ahead))
}

const FRONT: &str = "kind = \"range_finder\"\nname = \"front\"\ndirection = [1, 0, 0]\nrange_m = 10";

#[test]
fn environments_observe_sensors_and_tasks_see_by_them() {
    let mut env = ahead(FRONT, Autoreset::SameStep).unwrap();
    let channel = &env.sensor_channels()[0];
    assert_eq!((channel.name.as_str(), channel.channel.unit.as_ref()), ("front_range", "m"));
    env.reset(Some(3), None).unwrap();
    assert!(env.samples("front", "range").unwrap().iter().all(|r| (r - 3.0).abs() < 1e-5));
    // Tilted forward all the time, drones come nearer to the wall.
    let mut last = vec![3.0f32; 3];
    for step in 0..5 {
        env.step(&[0.0, 0.3, 0.0, 0.0].repeat(3)).unwrap();
        let now = match step {
            4 => env.final_samples("front", "range").unwrap().to_vec(),
            _ => env.samples("front", "range").unwrap().to_vec(),
        };
        assert!(now.iter().zip(&last).all(|(now, last)| now != last), "{step}: {now:?} {last:?}");
        assert_eq!(env.reward(), now, "the reward is what is sampled after the step");
        last = now;
    }
    // Episodes are over: new ones have samples of their own, and observe them.
    assert!(env.truncated().iter().all(|t| *t));
    assert!(env.samples("front", "range").unwrap().iter().all(|r| (r - 3.0).abs() < 1e-5));
    assert!((env.observation()[13] - 6.0).abs() < 1e-4);
    assert!(env.samples("front", "color").is_err() && env.final_samples("rear", "range").is_err());
}

#[test]
fn slow_sensors_of_environments_hold_their_samples_and_fast_ones_are_refused() {
    let mut env = ahead(&format!("{FRONT}\nsample_hz = 20"), Autoreset::Disabled).unwrap();
    env.reset(Some(3), None).unwrap();
    let mut all = vec![env.samples("front", "range").unwrap()[0]];
    for _ in 0..5 {
        env.step(&[0.0, 0.3, 0.0, 0.0].repeat(3)).unwrap();
        all.push(env.samples("front", "range").unwrap()[0]);
    }
    // 20 Hz at 50 steps a second: at steps 0, 3 and 5.
    let new: Vec<bool> = all.windows(2).map(|w| w[0] != w[1]).collect();
    assert_eq!(new, [false, false, true, false, true], "{all:?}");
    let error = ahead(&format!("{FRONT}\nsample_hz = 100"), Autoreset::Disabled).unwrap_err().to_string();
    assert!(error.contains("front") && error.contains("1 to 50 Hz"), "{error}");
    let error = env.add_sensor(imu(), None).unwrap_err().to_string();
    assert!(error.contains("before the first reset"), "{error}");
    let mut env = ahead(FRONT, Autoreset::Disabled).unwrap();
    env.add_sensor(imu(), Some(25)).unwrap();
    let names: Vec<&str> = env.sensor_channels().iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["front_range", "imu_accelerometer", "imu_gyroscope", "imu_saturated"]);
}
