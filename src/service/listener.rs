//! A listening socket in the file system.

use crate::service::ServiceError;
use crate::service::client::connect_within;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socket2::{Domain, SockAddr, Socket, Type};
use std::io::ErrorKind;
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Connections that wait to be accepted: no longer than two rounds.
const BACKLOG: i32 = 64;
/// Longest wait for another service that listens on the same path.
const ANSWER_MAX: Duration = Duration::from_millis(200);

/// A socket that accepts without waiting. Its file is removed with it.
#[derive(Debug)]
pub struct Listener {
    socket: UnixListener,
    path: PathBuf,
    /// Device and inode of the socket file: a file that another service has put there is left alone.
    inode: (u64, u64),
}

impl Listener {
    /// True if a socket is there on which nobody listens any longer, false if nothing is there.
    ///
    /// # Errors
    /// [`ServiceError::Socket`] if another service listens there or it cannot be told, and for a file of another kind.
    pub fn is_stale(path: &Path) -> Result<bool, ServiceError> {
        let refuse = |why: &str| Err(ServiceError::socket(path)(std::io::Error::other(why)));
        let Ok(there) = std::fs::symlink_metadata(path) else {
            return Ok(false);
        };
        if !there.file_type().is_socket() {
            return refuse("a file of another kind is there; name another path");
        }
        match connect_within(path, ANSWER_MAX) {
            Ok(_) => refuse("another service already answers on this socket"),
            Err(e) if e.kind() == ErrorKind::ConnectionRefused => Ok(true),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(false),
            Err(e) if e.kind() == ErrorKind::WouldBlock => {
                refuse("another service listens here and does not answer; end it first")
            }
            Err(e) => refuse(&format!(
                "it cannot be told whether another service listens here ({e}); name another path"
            )),
        }
    }

    /// Creates the socket with the given permission bits. A stale socket file is replaced.
    ///
    /// # Errors
    /// As for [`is_stale`](Self::is_stale), and the operating system's.
    pub fn bind(path: &Path, mode: u32) -> Result<Self, ServiceError> {
        let stale = Self::is_stale(path)?;
        let listen = || -> std::io::Result<Self> {
            if stale {
                std::fs::remove_file(path)?;
            }
            let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
            socket.bind(&SockAddr::unix(path)?)?;
            // nobody can connect before the permissions are set
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))?;
            socket.listen(BACKLOG)?;
            socket.set_nonblocking(true)?;
            Ok(Self {
                socket: socket.into(),
                path: path.to_owned(),
                inode: inode(path)?,
            })
        };
        listen().map_err(ServiceError::socket(path))
    }

    /// The next connection that waits, as one that does not block.
    pub fn accept(&self) -> Option<UnixStream> {
        let (stream, _) = self.socket.accept().ok()?;
        stream.set_nonblocking(true).ok().map(|()| stream)
    }

    /// An entry for [`wait`].
    pub fn entry(&self) -> PollFd<'_> {
        PollFd::new(self.socket.as_fd(), PollFlags::POLLIN)
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if inode(&self.path).is_ok_and(|there| there == self.inode) {
            // the file may be gone already
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Waits until one of the descriptors is ready, at most for this time.
pub fn wait(set: &mut [PollFd<'_>], time: Duration) {
    // after a failure the round merely starts early
    let _ = poll(set, PollTimeout::try_from(time).unwrap_or(PollTimeout::MAX));
}

fn inode(path: &Path) -> std::io::Result<(u64, u64)> {
    std::fs::symlink_metadata(path).map(|m| (m.dev(), m.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use socket2::SockRef;

    #[test]
    fn a_file_that_is_no_socket_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes.txt");
        std::fs::write(&path, "mine").unwrap();
        let error = Listener::bind(&path, 0o600).unwrap_err().to_string();
        assert!(
            error.contains("another kind") && error.contains("notes.txt"),
            "{error}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    }

    #[test]
    fn only_a_socket_on_which_nobody_listens_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        assert!(!Listener::is_stale(&path).unwrap());
        let live = UnixListener::bind(&path).unwrap();
        let why = Listener::bind(&path, 0o600).unwrap_err().to_string();
        assert!(why.contains("already answers"), "{why}");
        // a queue that is full, as that of a service that hangs
        SockRef::from(&live).listen(0).unwrap();
        let _waits: Vec<_> = (0..2)
            .filter_map(|_| connect_within(&path, Duration::from_millis(50)).ok())
            .collect();
        let why = Listener::bind(&path, 0o600).unwrap_err().to_string();
        assert!(why.contains("does not answer"), "{why}");
        drop(live);
        assert!(Listener::is_stale(&path).unwrap());
        Listener::bind(&path, 0o600).unwrap();
    }

    #[test]
    fn a_socket_that_another_service_has_replaced_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let first = Listener::bind(&path, 0o600).unwrap();
        assert_eq!(
            std::fs::metadata(&path).unwrap().permissions().mode() & 0o777,
            0o600
        );
        std::fs::remove_file(&path).unwrap();
        let second = Listener::bind(&path, 0o600).unwrap();
        drop(first);
        assert!(path.exists());
        drop(second);
        assert!(!path.exists());
    }
}
