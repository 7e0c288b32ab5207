//! What can be asked.

use std::convert::Infallible;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::HeaderMap;
use axum::middleware;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, post, put};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio_stream::wrappers::BroadcastStream;
use tokio_stream::{Stream, StreamExt as _};

use super::answer::{Answer, Refusal, file};
use super::desk::{Desk, Use};
use super::engine::{Engine, Step};
use super::examples::EXAMPLES;
use super::guard::guard;
use super::mapping::Choice;
use super::room::Room;
use super::saving::{Kind, Saving};
use super::worker::{Run, Worker};
use super::{MAX_SESSIONS, MAX_UPLOAD_BYTES, page, uploads};
use crate::scene::SCENES;
use crate::vehicle::BUILTIN;

/// Largest body of a request that is no upload, bytes.
const MAX_BODY: usize = 1 << 20;

type Shared = State<Arc<Room>>;

/// All routes, behind the door.
pub fn all(room: Arc<Room>) -> Router {
    Router::new()
        .route("/", get(page::index))
        .route("/page/{file}", get(page::file))
        .route("/api/start", get(start))
        .route("/api/sessions", post(open))
        .route("/api/sessions/{id}", delete(end).get(state))
        .route("/api/sessions/{id}/events", get(events))
        .route("/api/sessions/{id}/cancel", post(cancel))
        .route("/api/sessions/{id}/do/{verb}", post(act))
        .route("/api/sessions/{id}/files/{which}", get(download))
        .layer(DefaultBodyLimit::max(MAX_BODY))
        // Uploads are counted while they come.
        .merge(
            Router::new().route("/api/sessions/{id}/files", put(upload)).layer(DefaultBodyLimit::disable()),
        )
        .fallback(|| async { Refusal::missing("there is nothing of this name in the lab") })
        .layer(middleware::from_fn_with_state(room.clone(), guard))
        .with_state(room)
}

/// Waits for a worker.
async fn answered(answer: oneshot::Receiver<Answer>) -> Answer {
    answer.await.unwrap_or_else(|_| {
        Err(Refusal::missing("this session was closed: begin a new one on the start page"))
    })
}

fn respond(answer: Answer) -> Response {
    answer.map(axum::Json).into_response()
}

/// What the start page offers.
async fn start(State(room): Shared) -> Response {
    let mut sessions = Vec::new();
    for id in room.sessions() {
        let Ok(worker) = room.session(id) else { continue };
        // A session that works is not asked: its answer would come late.
        let about = if worker.is_busy() { "working …".into() } else { about(&worker).await };
        sessions.push(json!({ "id": id, "about": about }));
    }
    let examples: Vec<Value> =
        EXAMPLES.iter().map(|e| json!({ "name": e.name, "title": e.title, "about": e.about })).collect();
    let given =
        !room.options.logs.is_empty() || room.options.vehicle.is_some() || room.options.scene.is_some();
    respond(Ok(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "examples": examples,
        "vehicles": BUILTIN,
        "scenes": SCENES,
        "sessions": sessions,
        "most_sessions": MAX_SESSIONS,
        "most_upload_bytes": MAX_UPLOAD_BYTES,
        "given": given,
        "folder": room.folder,
    })))
}

async fn about(worker: &Worker) -> String {
    let asked = worker.ask("about", |desk, _| Ok(Value::from(desk.about())));
    answered(asked).await.ok().and_then(|v| v.as_str().map(String::from)).unwrap_or_default()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Open {
    /// Whether it begins with the files of the command line.
    #[serde(default)]
    given: bool,
}

async fn open(State(room): Shared, body: Bytes) -> Response {
    let asked: Open = match read(&body) {
        Ok(asked) => asked,
        Err(refusal) => return refusal.into_response(),
    };
    let opened = tokio::task::spawn_blocking(move || room.open(asked.given)).await;
    let answer = opened.unwrap_or_else(|_| {
        Err(Refusal::bad("the session could not be begun: the program's terminal says why"))
    });
    respond(answer.map(|id| json!({ "id": id })))
}

async fn end(State(room): Shared, Path(id): Path<u64>) -> Response {
    respond(Ok(json!({ "ended": room.end(id) })))
}

async fn state(State(room): Shared, Path(id): Path<u64>) -> Response {
    let worker = match room.session(id) {
        Ok(worker) => worker,
        Err(refusal) => return refusal.into_response(),
    };
    let asked = worker.ask("state", |desk, _| {
        desk.look();
        Ok(desk.state())
    });
    respond(answered(asked).await)
}

async fn cancel(State(room): Shared, Path(id): Path<u64>) -> Response {
    respond(room.session(id).map(|worker| json!({ "cancelled": worker.cancel() })))
}

/// News of a session, as they come. A page that lags too far behind misses some, and asks for the state.
async fn events(State(room): Shared, Path(id): Path<u64>) -> Response {
    let worker = match room.session(id) {
        Ok(worker) => worker,
        Err(refusal) => return refusal.into_response(),
    };
    Sse::new(news(&worker)).keep_alive(KeepAlive::default()).into_response()
}

fn news(worker: &Worker) -> impl Stream<Item = Result<Event, Infallible>> + use<> {
    BroadcastStream::new(worker.listen())
        .map(|told| Ok(Event::default().data(told.unwrap_or_else(|_| "{\"missed\":true}".into()))))
}

#[derive(Deserialize)]
struct Named {
    name: String,
}

async fn upload(
    State(room): Shared,
    Path(id): Path<u64>,
    query: Query<Named>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    let taken = async {
        let worker = room.session(id)?;
        let name = uploads::plain(&query.name);
        let folder = worker.folder_for_upload()?;
        let path = uploads::receive(&headers, body, &folder, &name).await?;
        let number = path.clone();
        answered(worker.ask(format!("take {}", number.display()), move |desk, _| {
            desk.take(&name, &path).map(|t| with(desk, t))
        }))
        .await
    };
    respond(taken.await)
}

fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Refusal> {
    let body = if body.is_empty() { b"{}" } else { body };
    serde_json::from_slice(body).map_err(|e| {
        Refusal::bad(format!("the request is not what the page sends: {e}; load the page again"))
    })
}

/// The state, and what the work came to.
fn with(desk: &Desk, result: Value) -> Value {
    json!({ "state": desk.state(), "result": result })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Which {
    log: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Chosen {
    name: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Used {
    log: usize,
    used: Use,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Map {
    log: usize,
    choice: Choice,
    #[serde(default)]
    keep: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Go {
    step: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Toggle {
    effect: String,
    on: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Only {
    effects: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Slide {
    effect: String,
    handle: usize,
    share: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exactly {
    flight: usize,
    window: Option<[f64; 2]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Expression {
    axis: String,
    text: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct InABox {
    box_m: [f64; 3],
}

type Work = Box<dyn FnOnce(&mut Desk, &Run) -> Answer + Send>;

/// What a verb is about, and its work.
fn then(
    about: impl Into<String>,
    work: impl FnOnce(&mut Desk, &Run) -> Answer + Send + 'static,
) -> Result<(String, Work), Refusal> {
    Ok((about.into(), Box::new(work)))
}

/// A verb with what it is about (a newer one about the same replaces it while it waits) and its work.
fn work(verb: &str, body: &[u8]) -> Result<(String, Work), Refusal> {
    match verb {
        "example" => {
            let asked: Named = read(body)?;
            then("example", move |desk, _| desk.example(&asked.name))
        }
        "vehicle" => {
            let asked: Named = read(body)?;
            then("vehicle", move |desk, _| desk.choose_vehicle(&asked.name))
        }
        "scene" => {
            let asked: Chosen = read(body)?;
            then("scene", move |desk, _| desk.choose_scene(asked.name.as_deref()))
        }
        "shapes" => then("shapes", |desk, _| desk.scene()),
        "use" => {
            let asked: Used = read(body)?;
            then(format!("use {}", asked.log), move |desk, _| desk.set_use(asked.log, asked.used))
        }
        "remove" => {
            let asked: Which = read(body)?;
            then(format!("remove {}", asked.log), move |desk, _| desk.remove(asked.log))
        }
        "columns" => {
            let asked: Which = read(body)?;
            then("columns", move |desk, _| desk.columns(asked.log))
        }
        "map" => {
            let asked: Map = read(body)?;
            then(if asked.keep { "keep map" } else { "map" }, move |desk, _| {
                desk.map(asked.log, &asked.choice, asked.keep)
            })
        }
        _ => engine_work(verb, body),
    }
}

/// Verbs of the engine.
fn engine_work(verb: &str, body: &[u8]) -> Result<(String, Work), Refusal> {
    match verb {
        "open" => then("open", |desk, _| desk.open()),
        "live" => then("live", |desk, _| desk.engine()?.live()),
        "find" => then("find", |desk, run| desk.engine()?.find(run)),
        "fit" => then("fit", |desk, run| desk.engine()?.fit(run)),
        "undo" => then("step", |desk, _| desk.engine()?.step(Step::Back)),
        "redo" => then("step", |desk, _| desk.engine()?.step(Step::On)),
        "go" => {
            let asked: Go = read(body)?;
            then("step", move |desk, _| desk.engine()?.step(Step::To(asked.step)))
        }
        "toggle" => {
            let asked: Toggle = read(body)?;
            then(format!("toggle {}", asked.effect), move |desk, _| {
                desk.engine()?.change(|s| s.toggle(&asked.effect, asked.on))
            })
        }
        "only" => {
            let asked: Only = read(body)?;
            then("only", move |desk, _| desk.engine()?.only(&asked.effects))
        }
        "set" => {
            let asked: Slide = read(body)?;
            let about = format!("set {} {}", asked.effect, asked.handle);
            then(about, move |desk, _| desk.engine()?.set(&asked.effect, asked.handle, asked.share))
        }
        "exact" => {
            let asked: Exactly = read(body)?;
            then("exact", move |desk, _| desk.engine()?.exact(asked.flight, asked.window))
        }
        "try_expression" => {
            let asked: Expression = read(body)?;
            then("try_expression", move |_, _| Engine::judge(&asked.axis, &asked.text))
        }
        "expression" => {
            let asked: Expression = read(body)?;
            then("expression", move |desk, _| desk.engine()?.expression(&asked.axis, &asked.text))
        }
        "next" => {
            let asked: InABox = read(body)?;
            then("next", move |desk, _| desk.engine()?.next(asked.box_m))
        }
        "preview" => then("preview", |desk, _| desk.preview()),
        "save" => {
            let asked: Saving = read(body)?;
            then("save", move |desk, _| desk.save(&asked))
        }
        _ => Err(Refusal::missing(format!("the lab does not know `{verb}`: load the page again"))),
    }
}

/// A file of those that could be saved, for the browser to keep.
async fn download(State(room): Shared, Path((id, which)): Path<(u64, Kind)>) -> Response {
    let made = async {
        let worker = room.session(id)?;
        answered(worker.ask(format!("file {which:?}"), move |desk, _| {
            desk.file(which).map(|(name, text)| json!([name, text]))
        }))
        .await
    };
    match made.await {
        Ok(made) => {
            let part = |k: usize| made[k].as_str().unwrap_or_default();
            file(part(0), "application/octet-stream", part(1).to_string())
        }
        Err(refusal) => refusal.into_response(),
    }
}

async fn act(State(room): Shared, Path((id, verb)): Path<(u64, String)>, body: Bytes) -> Response {
    let done = async {
        let worker = room.session(id)?;
        let (about, work) = work(&verb, &body)?;
        answered(worker.ask(about, move |desk, run| work(desk, run).map(|result| with(desk, result)))).await
    };
    respond(done.await)
}
