//! A minimal file system in user space for device files: `open`, `ioctl`, `release`.
//!
//! The kernel forwards ioctls on ordinary FUSE files. Those whose number encodes a size carry their
//! data with them. For the others (I2C_RDWR) the server receives the caller's pointer and thread and accesses
//! its memory with `process_vm_readv`. Layouts are those of `linux/fuse.h`, protocol 7.31.
#![allow(unsafe_code)]

use std::ffi::CString;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsRawFd;
use std::path::Path;

/// An ioctl.
pub struct Ioctl<'a> {
    /// Number of the request, for a later answer.
    pub unique: u64,
    /// The file.
    pub node: u64,
    /// Thread that called.
    pub thread: i32,
    /// Number.
    pub number: u32,
    /// Argument as the caller passed it.
    pub argument: u64,
    /// Data, where the number encodes a size.
    pub data: &'a [u8],
}

/// The answer to an ioctl.
pub enum Answer {
    /// Result, and data to hand back.
    Done(i32, Vec<u8>),
    /// An errno.
    Failed(i32),
    /// No answer: the call hangs.
    Never,
}

/// The files behind the mount. Nodes count from 2; 1 is the folder.
pub trait Files: Send {
    /// The node of a name.
    fn find(&mut self, name: &str) -> Option<u64>;
    /// An ioctl.
    fn ioctl(&mut self, call: &Ioctl<'_>) -> Answer;
    /// Permission bits of a file that belongs to root; the kernel enforces them.
    fn mode(&self, _node: u64) -> u32 {
        0o666
    }
    /// The last descriptor of a file is closed.
    fn released(&mut self, node: u64);
    /// The name of the one character device, where this is served through CUSE.
    fn device(&self) -> Option<&'static str> {
        None
    }
}

/// Mounts an empty FUSE file system; the returned file is the server's end of it.
pub fn mount(at: &Path) -> io::Result<File> {
    let file = File::options().read(true).write(true).open("/dev/fuse")?;
    let options = text(&format!(
        "fd={},rootmode=40000,user_id=0,group_id=0,allow_other,default_permissions",
        file.as_raw_fd()
    ));
    let (source, target, kind) = (
        text("emulated-pi"),
        text(&at.display().to_string()),
        text("fuse"),
    );
    // SAFETY: all five pointers are to live C strings, and mount(2) only reads them.
    let done = unsafe {
        libc::mount(
            source.as_ptr(),
            target.as_ptr(),
            kind.as_ptr(),
            0,
            options.as_ptr().cast(),
        )
    };
    if done == 0 {
        Ok(file)
    } else {
        Err(io::Error::last_os_error())
    }
}

fn text(s: &str) -> CString {
    CString::new(s).expect("no zero in the names used here")
}

/// Reads memory of a thread's process.
pub fn peek(thread: i32, address: u64, into: &mut [u8]) -> bool {
    let local = libc::iovec {
        iov_base: into.as_mut_ptr().cast(),
        iov_len: into.len(),
    };
    let remote = libc::iovec {
        iov_base: address as *mut libc::c_void,
        iov_len: into.len(),
    };
    // SAFETY: `local` covers `into`, which is live and exclusively borrowed; the remote side is checked by
    // the kernel.
    unsafe { libc::process_vm_readv(thread, &local, 1, &remote, 1, 0) == into.len() as isize }
}

/// Writes memory of a thread's process.
pub fn poke(thread: i32, address: u64, from: &[u8]) -> bool {
    let local = libc::iovec {
        iov_base: from.as_ptr().cast_mut().cast(),
        iov_len: from.len(),
    };
    let remote = libc::iovec {
        iov_base: address as *mut libc::c_void,
        iov_len: from.len(),
    };
    // SAFETY: `local` covers `from`, which process_vm_writev only reads; the remote side is checked by the
    // kernel.
    unsafe { libc::process_vm_writev(thread, &local, 1, &remote, 1, 0) == from.len() as isize }
}

/// A number at an offset.
pub fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

/// A long number at an offset.
pub fn long(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

const LOOKUP: u32 = 1;
const FORGET: u32 = 2;
const GETATTR: u32 = 3;
const OPEN: u32 = 14;
const RELEASE: u32 = 18;
const FLUSH: u32 = 25;
const INIT: u32 = 26;
const OPENDIR: u32 = 27;
const RELEASEDIR: u32 = 29;
const ACCESS: u32 = 34;
const INTERRUPT: u32 = 36;
const IOCTL: u32 = 39;
const BATCH_FORGET: u32 = 42;
const CUSE_INIT: u32 = 4096;

/// Answer to CUSE_INIT: version, unrestricted ioctls, sizes, any device number, the name.
fn character_device(name: &str) -> Vec<u8> {
    let mut out: Vec<u8> = [7_u32, 31, 0, 1, 65536, 65536, 0, 0]
        .into_iter()
        .flat_map(u32::to_le_bytes)
        .collect();
    out.extend([0_u8; 40]);
    out.extend(format!("DEVNAME={name}\0").bytes());
    out
}

/// Attributes of a node: a folder or a file.
fn attributes(node: u64, bits: u32) -> Vec<u8> {
    let mode: u32 = if node == 1 { 0o40755 } else { 0o100_000 | bits };
    let mut a = vec![0_u8; 88];
    a[0..8].copy_from_slice(&node.to_le_bytes());
    a[60..64].copy_from_slice(&mode.to_le_bytes());
    a[64..68].copy_from_slice(&1_u32.to_le_bytes());
    a
}

/// Answers a request.
pub fn reply(mut to: &File, unique: u64, error: i32, body: &[u8]) {
    let mut out = Vec::with_capacity(16 + body.len());
    out.extend((16 + body.len() as u32).to_le_bytes());
    out.extend((-error).to_le_bytes());
    out.extend(unique.to_le_bytes());
    out.extend(body);
    // the caller may have been killed
    let _ = to.write_all(&out);
}

/// An ioctl's result with its data.
pub fn ioctl_body(result: i32, data: &[u8]) -> Vec<u8> {
    let mut body = result.to_le_bytes().to_vec();
    body.extend([0_u8; 12]);
    body.extend(data);
    body
}

/// Serves until the file system is gone.
pub fn serve<F: Files>(file: &File, lock: &std::sync::Mutex<F>) {
    let mut buffer = vec![0_u8; 1 << 17];
    loop {
        let mut from = file;
        let n = match from.read(&mut buffer) {
            Ok(n) => n,
            Err(e) if e.raw_os_error() == Some(libc::EINTR) => continue,
            Err(_) => return,
        };
        let (head, body) = buffer[..n].split_at(40);
        let (op, unique, node, thread) = (
            word(head, 4),
            long(head, 8),
            long(head, 16),
            word(head, 32) as i32,
        );
        let mut files = lock
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let answer: Result<Vec<u8>, i32> = match op {
            INIT => {
                let mut out = vec![0_u8; 64];
                (out[0], out[4]) = (7, 31);
                out[20..24].copy_from_slice(&65536_u32.to_le_bytes());
                Ok(out)
            }
            LOOKUP => {
                let name = String::from_utf8_lossy(body.split(|b| *b == 0).next().unwrap_or(b""))
                    .into_owned();
                files.find(&name).map_or(Err(libc::ENOENT), |node| {
                    let mut out = node.to_le_bytes().to_vec();
                    out.extend([0_u8; 32]);
                    out.extend(attributes(node, files.mode(node)));
                    Ok(out)
                })
            }
            GETATTR => Ok([vec![0_u8; 16], attributes(node, files.mode(node))].concat()),
            OPEN | OPENDIR => Ok(vec![0_u8; 16]),
            RELEASE => {
                files.released(node);
                Ok(vec![])
            }
            FLUSH | RELEASEDIR | ACCESS => Ok(vec![]),
            IOCTL => {
                let call = Ioctl {
                    unique,
                    node,
                    thread,
                    number: word(body, 12),
                    argument: long(body, 16),
                    data: &body[32..],
                };
                match files.ioctl(&call) {
                    Answer::Done(result, data) => Ok(ioctl_body(result, &data)),
                    Answer::Failed(errno) => Err(errno),
                    Answer::Never => continue,
                }
            }
            INTERRUPT => {
                // a call that hangs ends when its caller ends
                reply(file, long(body, 0), libc::EINTR, &[]);
                continue;
            }
            FORGET | BATCH_FORGET => continue,
            CUSE_INIT => files.device().map(character_device).ok_or(libc::ENOSYS),
            _ => Err(libc::ENOSYS),
        };
        drop(files);
        match answer {
            Ok(body) => reply(file, unique, 0, &body),
            Err(errno) => reply(file, unique, errno, &[]),
        }
    }
}
