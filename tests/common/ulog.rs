//! PX4 logs (ULog) made for tests.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

/// Topics as they are declared: name, and the fields beside the time.
pub const TOPICS: [(&str, &str); 6] = [
    ("vehicle_local_position", "float x;float y;float z;float vx;float vy;float vz"),
    ("vehicle_attitude", "float[4] q"),
    ("vehicle_angular_velocity", "float[3] xyz"),
    ("vehicle_acceleration", "float[3] xyz"),
    ("actuator_motors", "float[6] control"),
    ("battery_status", "float voltage_v"),
];

/// A file with one record of each of [`TOPICS`] at every time (µs): the numbers of their fields; none where there are no numbers.
pub fn file(rows: impl IntoIterator<Item = (u64, [Vec<f64>; 6])>) -> Vec<u8> {
    let mut out = b"ULog\x01\x12\x35\x01".to_vec();
    out.extend(0u64.to_le_bytes());
    let mut message = |kind: u8, payload: &[u8]| {
        out.extend((payload.len() as u16).to_le_bytes());
        out.push(kind);
        out.extend(payload);
    };
    message(b'B', &[0; 40]);
    for (name, fields) in TOPICS {
        message(b'F', format!("{name}:uint64_t timestamp;{fields}").as_bytes());
    }
    for (id, (name, _)) in TOPICS.iter().enumerate() {
        message(b'A', &[&[0u8, id as u8, 0], name.as_bytes()].concat());
    }
    for (time_us, values) in rows {
        for (id, values) in values.iter().enumerate().filter(|(_, v)| !v.is_empty()) {
            let mut payload = (id as u16).to_le_bytes().to_vec();
            payload.extend(time_us.to_le_bytes());
            values.iter().for_each(|v| payload.extend((*v as f32).to_le_bytes()));
            message(b'D', &payload);
        }
    }
    out
}

/// A tenth of a second of hovering.
pub fn short() -> Vec<u8> {
    let row = |i: u64| {
        let x = 0.01 * i as f64;
        let of_motors = vec![0.5, 0.5, 0.5, 0.5, f64::NAN, f64::NAN];
        let values = [
            vec![x, 0.0, -1.0, 0.1, 0.0, 0.0],
            vec![1.0, 0.0, 0.0, 0.0],
            vec![0.0; 3],
            vec![0.0, 0.0, -9.8],
            of_motors,
            vec![3.9],
        ];
        (5_000_000 + 10_000 * i, values)
    };
    file((0..10).map(row))
}
