//! The files that the page is made of. They are the modules of reports and of `propwash view`, served as files, since the page's policy allows
//! no script and no style inside it.

use axum::extract::Path;
use axum::response::{IntoResponse, Response};

use super::answer::{Refusal, bytes};
use crate::page::Part;

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

const INDEX: &str = include_str!("../../assets/page/lab/index.html");

/// Files of the lab by name, with what is in them.
const FILES: &[(&str, &str)] = &[
    ("report.css", include_str!("../../assets/page/report.css")),
    ("report.js", include_str!("../../assets/page/report.js")),
    ("live.js", include_str!("../../assets/page/live.js")),
    ("lab.css", include_str!("../../assets/page/lab/lab.css")),
    ("ask.js", include_str!("../../assets/page/lab/ask.js")),
    ("start.js", include_str!("../../assets/page/lab/start.js")),
    ("check.js", include_str!("../../assets/page/lab/check.js")),
    ("map.js", include_str!("../../assets/page/lab/map.js")),
    ("flight.js", include_str!("../../assets/page/lab/flight.js")),
    ("next.js", include_str!("../../assets/page/lab/next.js")),
    ("save.js", include_str!("../../assets/page/lab/save.js")),
    ("main.js", include_str!("../../assets/page/lab/main.js")),
];

/// Files that other pages have too.
fn shared(name: &str) -> Option<&'static str> {
    Some(match name {
        "three.js" => Part::Three.script(),
        "uPlot.js" => Part::UPlot.script(),
        "uPlot.css" => Part::UPlot.style()?,
        "base.js" => Part::Base.script(),
        "page.css" => Part::Base.style()?,
        "player.js" => Part::Player.script(),
        "plots.js" => Part::Plots.script(),
        "scene3d.js" => Part::Scene3D.script(),
        _ => return None,
    })
}

/// The page.
pub async fn index() -> Response {
    bytes(HTML, INDEX)
}

/// A script or a style of the page.
pub async fn file(Path(name): Path<String>) -> Response {
    let own = FILES.iter().find(|(n, _)| *n == name).map(|(_, text)| *text);
    match own.or_else(|| shared(&name)) {
        Some(text) => bytes(if name.ends_with(".css") { STYLE } else { SCRIPT }, text),
        None => Refusal::missing(format!("the page has no file `{name}`")).into_response(),
    }
}
