//! What flew: drones, and what is known of them over time.

use serde::Serialize;

use super::Moment;
use crate::page::Array;
use crate::vehicle::Vehicle;

/// Most samples of a track: 100 a second over 60 s.
pub(super) const MAX_SAMPLES: usize = 6000;

/// A vehicle as it is drawn.
#[derive(Clone, Debug, Serialize)]
pub struct Drone {
    /// Its name.
    pub name: String,
    /// Where its rotors are, m, body.
    pub rotors: Vec<[f64; 3]>,
    /// Radius of a rotor, m, where the file states one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// Whether the scene has its shell, so that only its rotors are drawn beside.
    pub shell: bool,
}

/// A vehicle as it is drawn.
pub(super) fn drone(vehicle: &Vehicle, shell: bool) -> Drone {
    let file = vehicle.file();
    let shared = file.rotor_default.as_ref();
    let rotors: Vec<[f64; 3]> = file
        .rotor
        .iter()
        .filter_map(|r| r.position_m.or_else(|| shared.and_then(|d| d.position_m)))
        .collect();
    let radius = file.rotor.first().and_then(|r| r.radius_m).or_else(|| shared.and_then(|d| d.radius_m));
    Drone { name: vehicle.name.clone(), radius, shell, ..unknown(rotors) }
}

/// A drone of which nothing is known but, maybe, where its rotors are: else four at the corners of a square of 0.2 m.
pub(super) fn unknown(rotors: Vec<[f64; 3]>) -> Drone {
    let rotors = if rotors.is_empty() {
        [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(|[x, y]| [0.1 * x, 0.1 * y, 0.0]).to_vec()
    } else {
        rotors
    };
    Drone { name: "drone".into(), rotors, radius: None, shell: false }
}

/// Poses of one drone over time.
#[derive(Clone, Debug, Serialize)]
pub struct Track {
    /// s.
    t: Array,
    /// m, world: x, y, z.
    pos: Vec<Array>,
    /// x, y, z, w, body to world.
    quat: Vec<Array>,
    /// m/s; NaN where it is not known.
    speed: Array,
}

impl Track {
    /// A track of rows of one length; every `1/n`-th where there are more than a page needs. Says how many it left out of how many.
    pub(super) fn new(
        t: &[f64],
        pos: &[[f64; 3]],
        quat: &[[f64; 4]],
        speed: &[f64],
    ) -> (Self, Option<[usize; 2]>) {
        let step = t.len().div_ceil(MAX_SAMPLES).max(1);
        // The last one stays, so that the path ends where the flight did, and so do gaps.
        let gap = |k: usize| !pos[k][0].is_finite();
        let kept: Vec<usize> =
            (0..t.len()).filter(|k| k % step == 0 || k + 1 == t.len() || gap(*k)).collect();
        let t_kept: Vec<f64> = kept.iter().map(|k| t[*k]).collect();
        let pos: Vec<[f64; 3]> = kept.iter().map(|k| pos[*k]).collect();
        let quat: Vec<[f64; 4]> = kept.iter().map(|k| quat[*k]).collect();
        let speed: Vec<f64> = kept.iter().map(|k| speed[*k]).collect();
        let track = Self {
            t: Array::f32(t_kept.iter().map(|t| *t as f32)).packed(),
            pos: super::columns(&pos),
            quat: super::columns(&quat),
            speed: Array::i16(&speed).packed(),
        };
        (track, (step > 1).then_some([kept.len(), t.len()]))
    }
}

/// A model that starts again from what was measured, every so many seconds.
#[derive(Clone, Debug, Serialize)]
pub struct Ghost {
    /// Time between two starts, s.
    pub every: f64,
    /// Its poses; NaN parts two starts.
    pub track: Track,
    /// When it starts, s.
    pub starts: Array,
}

/// Distances to the nearest thing over time.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Clearance {
    /// s.
    pub(super) t: Array,
    /// m; NaN where nothing is near.
    pub(super) distance: Array,
    /// Closest points on the drone and on the other geom, m, world.
    pub(super) from: Vec<Array>,
    pub(super) to: Vec<Array>,
    /// Number of the other geom, −1 none.
    pub(super) geom: Array,
}

/// Contacts of a world, one a row: numbers in double precision, as the table has them.
#[derive(Clone, Debug, Serialize)]
pub struct Marks {
    pub(super) t: Array,
    pub(super) drone: Array,
    /// m, world.
    pub(super) pos: Vec<Array>,
    /// Unit vectors from what is touched to the drone, world.
    pub(super) normal: Vec<Array>,
    /// Numbers of geoms: the drone's, the other's (−1 none).
    pub(super) geoms: Vec<Array>,
    pub(super) count: usize,
}

/// One world over time.
#[derive(Clone, Debug, Serialize)]
pub struct World {
    pub(super) number: usize,
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) note: String,
    /// (drone,)
    pub(super) drones: Vec<Track>,
    /// (drone,); none where it was not measured.
    pub(super) clearance: Vec<Clearance>,
    pub(super) contacts: Option<Marks>,
    pub(super) frames: Option<super::worlds::FrameData>,
    /// Of each obstacle; none where their places are not known.
    pub(super) obstacles: Vec<Track>,
    /// Models that fly beside the first drone.
    pub(super) ghosts: Vec<Ghost>,
}

/// A world of one moment.
pub(super) fn moment(of: &Moment, time_s: f64) -> World {
    let still = |(pos, quat): &([f64; 3], [f64; 4])| Track::new(&[time_s], &[*pos], &[*quat], &[f64::NAN]).0;
    World {
        number: of.world,
        from: time_s,
        to: time_s,
        note: String::new(),
        drones: of.drones.iter().map(still).collect(),
        clearance: Vec::new(),
        contacts: None,
        frames: None,
        obstacles: of.obstacles.iter().map(still).collect(),
        ghosts: Vec::new(),
    }
}
