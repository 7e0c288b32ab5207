//! Who may ask: this machine's person alone, by the secret of the address.
//!
//! The server is reachable by every program of the machine and, through the browser, by every site that the person visits. So a request must
//! name us as its host (else another site's name could lead here), come from our own page where it says where it comes from, and carry the
//! secret: in the address once, then as a cookie that other sites cannot send and scripts cannot read.

use std::fmt::Write as _;
use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;

use super::answer::bytes;
use super::room::Room;
use crate::{Error, Result};

/// Scripts, styles and requests of the page: its own alone, none of them inline.
const POLICY: &str = "default-src 'self'; connect-src 'self'; img-src 'self' data: blob:; style-src 'self'; script-src 'self'; \
                      object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Our port and secret.
pub struct Door {
    port: u16,
    token: String,
}

impl Door {
    /// A door with a new secret of 128 bits.
    pub fn new(port: u16) -> Result<Self> {
        let mut secret = [0; 16];
        getrandom::fill(&mut secret).map_err(|e| Error::Io {
            path: "the system's source of random numbers".into(),
            source: std::io::Error::other(e.to_string()),
        })?;
        let mut token = String::new();
        for byte in secret {
            let _ = write!(token, "{byte:02x}");
        }
        Ok(Self { port, token })
    }

    /// The address with the secret.
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/?token={}", self.port, self.token)
    }

    /// Ports share their cookies on one host: each lab has one of its own name.
    fn cookie(&self) -> String {
        format!("propwash_lab_{}", self.port)
    }

    fn is_ours(&self, host: &str) -> bool {
        [format!("127.0.0.1:{}", self.port), format!("localhost:{}", self.port)].iter().any(|h| h == host)
    }

    /// In time that does not depend on where the first difference is.
    fn is_token(&self, given: &str) -> bool {
        let differs = self.token.bytes().zip(given.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
        differs == 0 && given.len() == self.token.len()
    }

    /// Why a request is refused by what it says of itself.
    fn refuses(&self, headers: &HeaderMap) -> Option<&'static str> {
        let text = |name: HeaderName| headers.get(name).map(|v| v.to_str().unwrap_or("?"));
        if headers.get_all(header::HOST).iter().count() != 1
            || !text(header::HOST).is_some_and(|h| self.is_ours(h))
        {
            return Some("the lab answers as 127.0.0.1 or localhost with its own port alone");
        }
        let origin = text(header::ORIGIN);
        if origin.is_some_and(|o| !o.strip_prefix("http://").is_some_and(|h| self.is_ours(h))) {
            return Some("the lab takes requests of its own page alone");
        }
        None
    }

    fn has_cookie(&self, headers: &HeaderMap) -> bool {
        let name = self.cookie();
        let all = headers.get_all(header::COOKIE).iter().filter_map(|v| v.to_str().ok());
        let mut pairs = all.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
        pairs.any(|(key, value)| key == name && self.is_token(value))
    }

    fn token_of<'a>(&self, request: &'a Request) -> Option<&'a str> {
        let asks = request.method() == Method::GET && request.uri().path() == "/";
        let query = request.uri().query().filter(|_| asks)?;
        query.split('&').find_map(|pair| pair.strip_prefix("token="))
    }
}

/// Lets a request in, or says in words why not, and sets what every answer carries.
pub async fn guard(State(room): State<Arc<Room>>, request: Request, next: Next) -> Response {
    let door = &room.door;
    let refused = door.refuses(request.headers());
    let brings = refused.is_none() && door.token_of(&request).is_some_and(|t| door.is_token(t));
    let mut response = match refused {
        Some(words) => refusal(words),
        None if brings || door.has_cookie(request.headers()) => next.run(request).await,
        None => refusal(
            "open the address that `propwash lab` printed, with its token: this one is of another lab, or without a token",
        ),
    };
    let headers = response.headers_mut();
    if brings {
        let cookie = format!("{}={}; HttpOnly; SameSite=Strict; Path=/", door.cookie(), door.token);
        if let Ok(value) = HeaderValue::from_str(&cookie) {
            headers.insert(header::SET_COOKIE, value);
        }
    }
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

fn refusal(words: &'static str) -> Response {
    let mut response = bytes("text/plain; charset=utf-8", Body::from(words));
    *response.status_mut() = StatusCode::FORBIDDEN;
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_lab_has_a_secret_of_128_bits() {
        let [a, b] = [Door::new(80).unwrap(), Door::new(80).unwrap()];
        assert!(a.token.len() == 32 && a.token.bytes().all(|c| c.is_ascii_hexdigit()), "{}", a.token);
        assert_ne!(a.token, b.token);
        assert!(a.is_token(&a.token.clone()) && !a.is_token(&b.token) && !a.is_token(""));
        assert!(!a.is_token(&a.token[..31]) && !a.is_token(&format!("{}0", a.token)));
    }
}
