//! Which requests are answered.
//!
//! The port is bound to the loopback, but a page from any other place that is open in a browser of this machine can
//! send requests to it, and a foreign name can lead there (DNS rebinding). Two headers that a page cannot forge
//! show it: `Host` must name this port by an address of the loopback or by `localhost`, and `Origin`, where a
//! browser sends it, must be this page's own.

use std::net::SocketAddr;

/// A request that is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    Page,
    /// The report of the job that is over.
    Report,
    /// A WebSocket of the page: snapshots out, stop in.
    Live,
    Stop,
}

/// Why a request is not answered, with the status of HTTP.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// It does not name this port of the loopback.
    #[error("this page is for {0} only")]
    Host(SocketAddr),
    /// A request from another page.
    #[error("pages of {0} may not read this")]
    Origin(String),
    /// Nothing is there.
    #[error("there is no such page; the live page is at /")]
    Path,
    /// Not with this method.
    #[error("not with this method")]
    Method,
}

impl Refused {
    /// Status line of the answer.
    #[must_use]
    pub const fn status(&self) -> &'static str {
        match self {
            Self::Host(_) | Self::Origin(_) => "403 Forbidden",
            Self::Path => "404 Not Found",
            Self::Method => "405 Method Not Allowed",
        }
    }
}

/// Properties of a request.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asked<'a> {
    pub method: &'a str,
    /// Path, with its query.
    pub path: &'a str,
    /// `Host`.
    pub host: Option<&'a str>,
    /// `Origin`.
    pub origin: Option<&'a str>,
    /// It requests a WebSocket.
    pub upgrade: bool,
}

/// Judges a request at the port `own`.
pub fn judge(asked: &Asked<'_>, own: SocketAddr) -> Result<Wanted, Refused> {
    let names = names(own);
    if !asked.host.is_some_and(|host| names.iter().any(|name| name.eq_ignore_ascii_case(host))) {
        return Err(Refused::Host(own));
    }
    let is_own =
        |origin: &str| names.iter().any(|name| origin.eq_ignore_ascii_case(&format!("http://{name}")));
    if let Some(origin) = asked.origin.filter(|origin| !is_own(origin)) {
        return Err(Refused::Origin(origin.to_owned()));
    }
    let path = asked.path.split('?').next().unwrap_or_default();
    match (path, asked.method, asked.upgrade) {
        ("/stop", "POST", false) => Ok(Wanted::Stop),
        ("/live", "GET", true) => Ok(Wanted::Live),
        ("/", "GET", false) => Ok(Wanted::Page),
        ("/report", "GET", false) => Ok(Wanted::Report),
        ("/" | "/stop" | "/live" | "/report", _, _) => Err(Refused::Method),
        _ => Err(Refused::Path),
    }
}

/// What `Host` can be.
fn names(own: SocketAddr) -> [String; 3] {
    let port = own.port();
    [format!("127.0.0.1:{port}"), format!("localhost:{port}"), format!("[::1]:{port}")]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked<'a>(method: &'a str, path: &'a str, host: &'a str, origin: Option<&'a str>) -> Asked<'a> {
        Asked { method, path, host: Some(host), origin, ..Asked::default() }
    }

    #[test]
    fn only_this_port_of_the_loopback_and_pages_of_its_own_are_answered() {
        let own: SocketAddr = "127.0.0.1:8080".parse().unwrap();
        let judge = |asked: Asked<'_>| judge(&asked, own);
        let here = Some("http://localhost:8080");
        assert_eq!(judge(asked("GET", "/", "127.0.0.1:8080", None)), Ok(Wanted::Page));
        assert_eq!(judge(asked("GET", "/?x=1", "LOCALHOST:8080", here)), Ok(Wanted::Page));
        assert_eq!(judge(asked("POST", "/stop", "[::1]:8080", here)), Ok(Wanted::Stop));
        for host in ["evil.example:8080", "127.0.0.1", "127.0.0.1:81", "127.0.0.1:8080.evil.example", ""] {
            assert_eq!(judge(asked("POST", "/stop", host, None)), Err(Refused::Host(own)), "{host}");
        }
        assert_eq!(judge(Asked { host: None, ..asked("GET", "/", "", None) }), Err(Refused::Host(own)));
        for origin in
            ["http://evil.example", "null", "https://localhost:8080", "http://localhost:80", "file://"]
        {
            let refused = judge(asked("POST", "/stop", "localhost:8080", Some(origin)));
            assert_eq!(refused, Err(Refused::Origin(origin.to_owned())));
        }
        let page = Asked { upgrade: true, ..asked("GET", "/live", "localhost:8080", here) };
        assert_eq!(judge(page), Ok(Wanted::Live));
        assert_eq!(judge(Asked { path: "/", ..page }), Err(Refused::Method));
        assert_eq!(
            judge(asked("GET", "/stop", "localhost:8080", None)),
            Err(Refused::Method),
            "a link cannot stop"
        );
        assert_eq!(judge(asked("GET", "/../etc/passwd", "localhost:8080", None)), Err(Refused::Path));
    }
}
