//! The native caster and `mj_multiRay` as processes that are asked, by the protocol of benches/peers/depth.py.

use std::time::Instant;

use propwash::math::quat;
use propwash::scene::{Pose, Scene, SceneSource, Shell, Worker, WorkerPool};
use propwash::sense::{
    Camera, Caster, DepthBatch, DepthFrame, DepthKind, Lens, Queries, RayPattern, RayPlanes, RayQuery,
    WorldPoses,
};
use serde_json::json;

use super::common::Fallible;
use super::{Args, LIMIT_S, ROUND_S};

/// Rays of a sensor.
pub enum View {
    Image(usize, usize),
    Pattern(Vec<[f64; 3]>),
}

impl View {
    pub fn parse(text: &str) -> Fallible<Self> {
        if text == "fisheye" {
            // Equidistant: the angle from the axis grows with the distance from the middle, 110° at the edges.
            let mut rays = Vec::new();
            for row in 0..64 {
                for col in 0..64 {
                    let (x, y) = ((f64::from(col) - 31.5) / 32.0, (31.5 - f64::from(row)) / 32.0);
                    let (turn, angle) = (y.atan2(x), x.hypot(y) * 110f64.to_radians());
                    rays.push([angle.sin() * turn.cos(), angle.sin() * turn.sin(), -angle.cos()]);
                }
            }
            // Eight by eight in a row: neighbours in the list are neighbours in space.
            let tiled = (0..4096).map(|k| {
                let (tile, own) = (k / 64, k % 64);
                let (packet, lane) = (own / 16, own % 16);
                let row = 8 * (tile / 8) + 4 * (packet / 2) + lane / 4;
                rays[64 * row + 8 * (tile % 8) + 4 * (packet % 2) + lane % 4]
            });
            return Ok(Self::Pattern(tiled.collect()));
        }
        if text == "lidar" {
            // 32 rings from 25° below to 15° above the horizon of a sensor whose z axis points up.
            let mut rays = Vec::new();
            for ring in 0..32 {
                let up = (-25.0 + 40.0 * f64::from(ring) / 31.0).to_radians();
                for step in 0..1024 {
                    let turn = f64::from(step) * std::f64::consts::TAU / 1024.0;
                    // The sensor's y is up, as in a camera.
                    rays.push([up.cos() * turn.cos(), up.sin(), up.cos() * turn.sin()]);
                }
            }
            return Ok(Self::Pattern(rays));
        }
        let (width, height) =
            text.split_once('x').ok_or("--view: expected WIDTHxHEIGHT, fisheye or lidar")?;
        Ok(Self::Image(width.parse()?, height.parse()?))
    }

    pub fn rays(&self) -> usize {
        match self {
            Self::Image(width, height) => width * height,
            Self::Pattern(rays) => rays.len(),
        }
    }
}

/// One of ours.
trait Contestant {
    /// Casts call `k`.
    fn cast(&mut self, k: usize) -> Fallible<()>;
    /// Ranges of the last call.
    fn ranges(&self) -> Vec<f32>;
}

/// The side of ours of the protocol in the script.
pub fn serve(args: &Args, who: &str) -> Fallible<()> {
    let folder = args.folder.as_deref().ok_or("--folder is missing")?;
    let xml = std::fs::read_to_string(folder.join("scene.xml"))?;
    let bytes = std::fs::read(folder.join("poses.f64"))?;
    let numbers: Vec<f64> = bytes
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
        .collect();
    let poses: Vec<Pose> =
        numbers.chunks_exact(7).map(|p| Pose::new([p[0], p[1], p[2]], [p[3], p[4], p[5], p[6]])).collect();
    let view = View::parse(&args.view)?;
    let caster = if who == "native" { Caster::Native } else { Caster::MuJoCo };
    let (calls, frames) = if args.in_worlds { (1, poses.len()) } else { (poses.len(), 1) };
    let mut contestant: Box<dyn Contestant> = match (view, args.in_worlds) {
        (View::Image(width, height), true) => Box::new(Worlds::new(&xml, &poses, width, height, caster)?),
        (View::Pattern(_), true) => return Err("worlds have images only".into()),
        (view, false) => {
            let scene = Scene::build(&SceneSource::text("forest", &xml), &[])?;
            match caster {
                Caster::Native => Box::new(Native::new(&scene, poses, &view, args.normals)?),
                Caster::MuJoCo => Box::new(MultiRay::new(&scene, &poses, &view, args.normals)?),
            }
        }
    };
    let mut seen = Vec::new();
    for k in 0..calls {
        contestant.cast(k)?;
        if k == 0 {
            println!("{}", json!({ "first": true }));
        }
        for range in contestant.ranges() {
            seen.extend(range.to_le_bytes());
        }
    }
    std::fs::write(folder.join(format!("{who}.f32")), seen)?;
    println!("{}", json!({ "versions": "" }));
    for line in std::io::stdin().lines() {
        line?;
        let (begin, mut count) = (Instant::now(), 0);
        while begin.elapsed().as_secs_f64() < ROUND_S {
            for k in 0..calls {
                contestant.cast(k)?;
                count += frames;
                if begin.elapsed().as_secs_f64() > LIMIT_S {
                    break;
                }
            }
        }
        println!("{}", json!([count, begin.elapsed().as_secs_f64()]));
    }
    Ok(())
}

/// The native caster, by a camera or by a pattern.
struct Native {
    worker: Worker,
    cameras: Vec<Camera>,
    pattern: RayPattern,
    poses: Vec<Pose>,
    frame: DepthFrame,
}

impl Native {
    fn new(scene: &Scene, poses: Vec<Pose>, view: &View, normals: bool) -> Fallible<Self> {
        let (mut cameras, mut pattern, mut frame) = (Vec::new(), RayPattern::default(), DepthFrame::new());
        match view {
            View::Image(..) => cameras = image(scene, &poses, view, normals)?,
            View::Pattern(rays) => {
                pattern = RayPattern::new(rays)?;
                frame.depth_m.resize(pattern.len(), 0.0);
                frame.geom_id.resize(pattern.len(), 0);
                frame.body_id.resize(pattern.len(), 0);
            }
        }
        Ok(Self { worker: scene.worker()?, cameras, pattern, poses, frame })
    }
}

fn image(scene: &Scene, poses: &[Pose], view: &View, normals: bool) -> Fallible<Vec<Camera>> {
    let &View::Image(width, height) = view else { return Err("a pattern is no image".into()) };
    let lens = Lens::Fovy { fovy_deg: 45.0 };
    let make = |pose: &Pose| {
        let camera = Camera::in_world(scene, *pose, lens)?.with_size(width, height)?;
        Ok(camera.with_kind(DepthKind::Range).with_normals(normals))
    };
    poses.iter().map(make).collect()
}

impl Contestant for Native {
    fn cast(&mut self, k: usize) -> Fallible<()> {
        if let Some(camera) = self.cameras.get(k) {
            camera.render(&mut self.worker, &mut self.frame)?;
        } else {
            let planes = RayPlanes {
                range_m: Some(&mut self.frame.depth_m),
                geom_id: Some(&mut self.frame.geom_id),
                body_id: Some(&mut self.frame.body_id),
                normal: None,
            };
            Queries::at(&mut self.worker).pattern(
                &self.poses[k],
                &self.pattern,
                &RayQuery::default(),
                planes,
            )?;
        }
        Ok(())
    }

    fn ranges(&self) -> Vec<f32> {
        self.frame.depth_m.clone()
    }
}

/// `mj_multiRay` with directions that stand ready.
struct MultiRay {
    worker: Worker,
    rays: Vec<([f64; 3], Vec<[f64; 3]>)>,
    distances: Vec<f64>,
    geoms: Vec<i32>,
    normals: Option<Vec<[f64; 3]>>,
}

impl MultiRay {
    fn new(scene: &Scene, poses: &[Pose], view: &View, normals: bool) -> Fallible<Self> {
        let own: Vec<[f64; 3]> = match view {
            View::Image(..) => image(scene, &poses[..1], view, false)?[0].rays(),
            View::Pattern(rays) => rays.clone(),
        };
        let turn = |pose: &Pose| own.iter().map(|d| quat::rotate(pose.quat_xyzw, *d)).collect();
        Ok(Self {
            worker: scene.worker()?,
            rays: poses.iter().map(|pose| (pose.pos_m, turn(pose))).collect(),
            distances: vec![0.0; own.len()],
            geoms: vec![0; own.len()],
            normals: normals.then(|| vec![[0.0; 3]; own.len()]),
        })
    }
}

impl Contestant for MultiRay {
    fn cast(&mut self, k: usize) -> Fallible<()> {
        let (pos, rays) = &self.rays[k];
        let (distances, geoms) = (&mut self.distances, &mut self.geoms);
        self.worker.rays(*pos, rays, None, None, distances, geoms, self.normals.as_deref_mut())?;
        Ok(())
    }

    fn ranges(&self) -> Vec<f32> {
        self.distances.iter().map(|d| if *d < 0.0 { f32::INFINITY } else { *d as f32 }).collect()
    }
}

/// A drone with a camera in each of many worlds.
struct Worlds {
    pool: WorkerPool,
    camera: Camera,
    pos: Vec<f64>,
    quat: Vec<f64>,
    out: DepthBatch,
}

impl Worlds {
    fn new(xml: &str, poses: &[Pose], width: usize, height: usize, caster: Caster) -> Fallible<Self> {
        let shell = Shell {
            name: "eye".into(),
            xml: "<mujoco><worldbody><body name='drone'><geom size='0.05'/><camera name='fpv' fovy='45'/></body></worldbody></mujoco>"
                .into(),
            dir: None,
        };
        let scene = Scene::build(&SceneSource::text("forest", xml), &[shell])?;
        let camera = Camera::on_drone(&scene, 0, "fpv")?.with_size(width, height)?;
        let camera = camera.with_kind(DepthKind::Range).with_caster(caster);
        Ok(Self {
            pool: WorkerPool::new(&scene),
            camera,
            pos: poses.iter().flat_map(|p| p.pos_m).collect(),
            quat: poses.iter().flat_map(|p| p.quat_xyzw).collect(),
            out: DepthBatch::default(),
        })
    }
}

impl Contestant for Worlds {
    fn cast(&mut self, _: usize) -> Fallible<()> {
        let poses = WorldPoses {
            n_worlds: self.pos.len() / 3,
            drone_pos_m: &self.pos,
            drone_quat_xyzw: &self.quat,
            obstacle_pos_m: None,
            obstacle_quat_xyzw: None,
        };
        Ok(self.out.render(&poses.within(&self.pool), std::slice::from_ref(&self.camera))?)
    }

    fn ranges(&self) -> Vec<f32> {
        // Nobody compares these, and a copy would count as memory of the caster.
        Vec::new()
    }
}
