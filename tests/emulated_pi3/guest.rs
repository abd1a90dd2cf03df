//! The emulated machine: QEMU with its trace and two serial lines, and a hand on the first of them that runs
//! commands in the guest.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Longest that a command may take unless it is said otherwise, s.
const COMMAND_S: f64 = 120.0;

/// A running guest.
pub struct Guest {
    qemu: Child,
    to: ChildStdin,
    said: Receiver<u8>,
    transcript: File,
    folder: PathBuf,
    number: u32,
}

/// What a command left.
#[derive(Debug)]
pub struct Done {
    /// Exit code.
    pub code: i32,
    /// Both outputs.
    pub text: String,
}

impl Done {
    /// The words of the output on one line.
    pub fn flat(&self) -> String {
        crate::common::flat(&self.text)
    }
}

impl Guest {
    /// Starts QEMU on kernel, device tree and initrd in a folder; `words` are more arguments.
    pub fn start(folder: &Path, words: &[String]) -> Self {
        for pipe in ["trace", "motion"] {
            // left over from a run that was stopped
            let _ = std::fs::remove_file(folder.join(pipe));
        }
        assert!(
            Command::new("mkfifo")
                .arg(folder.join("trace"))
                .status()
                .expect("mkfifo")
                .success()
        );
        let path = |name: &str| folder.join(name).display().to_string();
        let mut qemu = Command::new("timeout");
        // whatever happens, it does not stay
        qemu.args([
            "-k",
            "10",
            "1200",
            "qemu-system-aarch64",
            "-M",
            "raspi3b",
            "-display",
            "none",
            "-monitor",
            "none",
            "-no-reboot",
        ]);
        qemu.args([
            "-kernel",
            &path("vmlinuz"),
            "-dtb",
            &path("pi3.dtb"),
            "-initrd",
            &path("initrd"),
        ]);
        // the registers may be mapped; no unit's progress between the marks
        qemu.args([
            "-append",
            "console=ttyAMA0,115200 iomem=relaxed panic=-1 loglevel=3 systemd.show_status=false",
        ]);
        qemu.args([
            "-serial",
            "stdio",
            "-serial",
            &format!("unix:{},server=on,wait=off", path("motion")),
        ]);
        qemu.args([
            "-trace",
            &format!("memory_region_ops_write,file={}", path("trace")),
        ]);
        qemu.args(words)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        qemu.stderr(File::create(folder.join("qemu.log")).expect("a log"));
        let mut qemu = qemu.spawn().expect("qemu-system-aarch64");
        let (to, mut from) = (
            qemu.stdin.take().expect("piped"),
            qemu.stdout.take().expect("piped"),
        );
        let (sender, said) = channel();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(n @ 1..) = from.read(&mut bytes) {
                if bytes[..n].iter().any(|b| sender.send(*b).is_err()) {
                    return;
                }
            }
        });
        let transcript = File::create(folder.join("transcript.txt")).expect("a transcript");
        Self {
            qemu,
            to,
            said,
            transcript,
            folder: folder.to_owned(),
            number: 0,
        }
    }

    /// The lines of the trace, as they come.
    pub fn trace(&self) -> impl Iterator<Item = String> + use<> {
        // for writing too, so that nobody waits for a QEMU that has not come up
        let pipe = File::options()
            .read(true)
            .write(true)
            .open(self.folder.join("trace"))
            .expect("the trace");
        BufReader::new(pipe).lines().map_while(Result::ok)
    }

    /// The other end of the second serial line.
    pub fn motion(&self) -> UnixStream {
        let began = Instant::now();
        loop {
            match UnixStream::connect(self.folder.join("motion")) {
                Ok(line) => return line,
                Err(e) => assert!(
                    began.elapsed() < Duration::from_secs(20),
                    "the second serial line: {e}"
                ),
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until the guest takes commands; how long it took, s.
    pub fn ready(&mut self, limit_s: f64) -> f64 {
        let began = Instant::now();
        self.until("@@ready\n", limit_s);
        began.elapsed().as_secs_f64()
    }

    /// Everything up to a mark, which is taken away.
    fn until(&mut self, mark: &str, limit_s: f64) -> String {
        let began = Instant::now();
        let mut bytes = Vec::new();
        while !bytes.ends_with(mark.as_bytes()) {
            match self.said.recv_timeout(Duration::from_secs(1)) {
                Ok(b'\r') => {}
                Ok(b) => {
                    bytes.push(b);
                    self.transcript.write_all(&[b]).expect("the transcript");
                }
                Err(RecvTimeoutError::Timeout) if began.elapsed().as_secs_f64() < limit_s => {}
                Err(why) => {
                    panic!(
                        "{why}: the guest did not say `{}` within {limit_s} s, but {}",
                        mark.trim(),
                        String::from_utf8_lossy(&bytes)
                    )
                }
            }
        }
        let all = String::from_utf8_lossy(&bytes).into_owned();
        all[..all.len() - mark.len()].to_owned()
    }

    /// Runs a command as root.
    pub fn run(&mut self, command: &str) -> Done {
        self.run_for(command, COMMAND_S)
    }

    /// Runs a command that may take long.
    pub fn run_for(&mut self, command: &str, limit_s: f64) -> Done {
        self.number += 1;
        let number = self.number;
        self.note(&format!("$ {command}"));
        writeln!(self.to, "{number} {command}").expect("the guest listens");
        self.until(&format!("@@begin {number}\n"), limit_s);
        let text = self.until(&format!("@@end {number} "), limit_s);
        let code = self.until("\n", 10.0).parse().expect("an exit code");
        Done {
            code,
            text: text.trim().to_owned(),
        }
    }

    /// A line of our own in the transcript.
    pub fn note(&mut self, line: &str) {
        writeln!(self.transcript, "## {line}").expect("the transcript");
    }

    /// Shuts down, gently first.
    pub fn end(mut self) -> bool {
        let _ = writeln!(self.to, "0 systemctl poweroff --no-block");
        let began = Instant::now();
        while began.elapsed() < Duration::from_secs(60) {
            if let Ok(Some(status)) = self.qemu.try_wait() {
                return status.success();
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        false
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        // gone already, if it was shut down; else `timeout` hands the signal on
        if matches!(self.qemu.try_wait(), Ok(None)) {
            let _ = Command::new("kill")
                .arg(self.qemu.id().to_string())
                .status();
            let _ = self.qemu.wait();
        }
    }
}
