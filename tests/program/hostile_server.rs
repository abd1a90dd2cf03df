//! Client commands against whatever may listen on the socket instead of a service: each ends in time, with one error and code 3.

use std::io::Write;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time of a command, and that of `stop`. Who is late among others on a busy computer is asked again alone.
const COMMAND_MAX: Duration = Duration::from_secs(3);
const STOP_MAX: Duration = Duration::from_secs(1);

#[derive(Debug, Clone, Copy)]
enum Server {
    /// Accepts nobody, and its queue is full.
    Hung,
    /// Accepts and says nothing.
    Silent,
    /// Sends events without an end, and no reply.
    Flooding,
    /// Sends a line without an end.
    Endless,
    /// Sends escape sequences instead of JSON.
    Garbage,
    /// Closes every connection.
    Closing,
}

/// Serves the command socket and that of `stop` until `done`.
fn serve(server: Server, folder: &Path, done: &Arc<AtomicBool>) -> Vec<JoinHandle<()>> {
    let mut threads = Vec::new();
    for name in ["control.sock", "control.stop.sock", "status.sock"] {
        let path = folder.join(name);
        let listener = UnixListener::bind(&path).unwrap();
        if matches!(server, Server::Hung) {
            let done = Arc::clone(done);
            threads.push(std::thread::spawn(move || {
                // the queue of the standard library holds 128 and more
                let mut waiting = Vec::new();
                while !done.load(Relaxed) {
                    let timeout = Duration::from_millis(20);
                    let full = retroflex::service::client::connect_within(&path, timeout);
                    waiting.extend(full.ok());
                }
                drop(listener);
            }));
            continue;
        }
        listener.set_nonblocking(true).unwrap();
        let done = Arc::clone(done);
        threads.push(std::thread::spawn(move || {
            let mut open: Vec<UnixStream> = Vec::new();
            while !done.load(Relaxed) {
                if let Ok((stream, _)) = listener.accept() {
                    stream.set_nonblocking(true).unwrap();
                    if !matches!(server, Server::Closing) {
                        open.push(stream);
                    }
                }
                let text = match server {
                    Server::Flooding => "{\"v\":1,\"event\":\"frame\",\"t\":1}\n".repeat(500),
                    Server::Endless => "1".repeat(65_536),
                    Server::Garbage => "\x1b[2J\x1b]0;x\x07\n".to_owned(),
                    _ => String::new(),
                };
                // whoever has gone hears nothing
                for stream in &mut open {
                    let _ = stream.write(text.as_bytes());
                }
                std::thread::sleep(Duration::from_millis(2));
            }
        }));
    }
    threads
}

#[test]
fn every_command_ends_whatever_listens() {
    let commands = [
        "stop",
        "status",
        "status --json -",
        "arm",
        "disarm",
        "bend 10 --toward 0",
        "hold",
        "relax",
        "zero",
        "record start",
        "calibrate transmission",
    ];
    for server in [
        Server::Hung,
        Server::Silent,
        Server::Flooding,
        Server::Endless,
        Server::Garbage,
        Server::Closing,
    ] {
        let folder = tempfile::tempdir().unwrap();
        let done = Arc::new(AtomicBool::new(false));
        let threads = serve(server, folder.path(), &done);
        std::thread::sleep(Duration::from_millis(300));
        let run = |command: &str| {
            let began = Instant::now();
            let output = Command::new(env!("CARGO_BIN_EXE_retroflex"))
                .args(command.split(' '))
                .arg("--socket")
                .arg(folder.path().join("control.sock"))
                .output()
                .unwrap();
            (output, began.elapsed())
        };
        std::thread::scope(|scope| {
            let all: Vec<_> = commands
                .iter()
                .map(|command| (command, scope.spawn(|| run(command))))
                .collect();
            for (command, one) in all {
                let (output, mut took) = one.join().unwrap();
                let most = if *command == "stop" {
                    STOP_MAX
                } else {
                    COMMAND_MAX
                };
                for _ in 0..3 {
                    if took < most {
                        break;
                    }
                    took = run(command).1;
                }
                let error = String::from_utf8_lossy(&output.stderr);
                println!("{server:?} {command}: {took:.1?} {error}");
                assert!(took < most, "{server:?} {command}: {took:.1?}");
                assert_eq!(
                    output.status.code(),
                    Some(3),
                    "{server:?} {command}: {error}"
                );
                assert_eq!(
                    error.matches("error:").count(),
                    1,
                    "{server:?} {command}: {error}"
                );
                assert!(!error.contains('\x1b'), "{server:?} {command}: {error:?}");
            }
        });
        done.store(true, Relaxed);
        threads
            .into_iter()
            .for_each(|thread| thread.join().unwrap());
    }
}
