//! A Raspberry Pi made of device files in the mount namespace of one thread. Only programs that this thread starts see
//! `/dev/i2c-1`, `/dev/gpiochip0`, `/dev/gpiomem` and the device tree.
#![allow(unsafe_code)]

use super::fuse;
use super::gpio::{HANDLE_FD, HANDLES};
use super::server::World;
use std::ffi::CString;
use std::fs::File;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tempfile::TempDir;

/// Device nodes that a program may need besides.
const NODES: [&str; 6] = [
    "null",
    "zero",
    "full",
    "random",
    "urandom",
    "cpu_dma_latency",
];

/// User and group without permissions.
const NOBODY: u32 = 65534;

/// A running emulation. The namespace goes with the thread.
pub struct Rig {
    world: Arc<Mutex<World>>,
    connection: Arc<File>,
    folder: TempDir,
}

fn text(path: impl AsRef<Path>) -> CString {
    CString::new(path.as_ref().display().to_string()).expect("no zero in a path")
}

fn mount(source: &Path, target: &Path, kind: &str, flags: libc::c_ulong) -> io::Result<()> {
    let (source, target, kind) = (text(source), text(target), text(kind));
    // SAFETY: pointers to live C strings which mount(2) only reads; no data.
    let done = unsafe {
        libc::mount(
            source.as_ptr(),
            target.as_ptr(),
            kind.as_ptr(),
            flags,
            std::ptr::null(),
        )
    };
    if done == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

/// Binds `source` over a fresh file.
fn bind(source: &Path, target: &Path) -> io::Result<()> {
    File::create(target)?;
    mount(source, target, "none", libc::MS_BIND)
}

impl Rig {
    /// Builds the namespace around the calling thread and serves a world in it.
    ///
    /// # Errors
    /// The step that the system refused, with the reason: not root, no FUSE, no namespaces.
    pub fn start(world: World) -> Result<Self, String> {
        let at = |step: &'static str| move |e: io::Error| format!("{step}: {e}");
        // SAFETY: takes flags only; CLONE_NEWNS gives this thread its own view of mounts.
        if unsafe { libc::unshare(libc::CLONE_NEWNS) } != 0 {
            return Err(at("a mount namespace of its own")(
                io::Error::last_os_error(),
            ));
        }
        mount(
            Path::new("none"),
            Path::new("/"),
            "none",
            libc::MS_REC | libc::MS_PRIVATE,
        )
        .map_err(at("private mounts"))?;
        let folder = TempDir::new().map_err(at("a folder"))?;
        let (files, dev) = (folder.path().join("files"), folder.path().join("dev"));
        for f in [&files, &dev] {
            std::fs::create_dir(f).map_err(at("a folder"))?;
        }
        let connection = Arc::new(fuse::mount(&files).map_err(at("mounting FUSE"))?);
        let world = Arc::new(Mutex::new(world));
        let (end, shared) = (connection.clone(), world.clone());
        std::thread::spawn(move || {
            // its priority is above that of every thread that it serves, which would otherwise wait for itself
            let _guard = retroflex::hardware::rt::enter(&retroflex::hardware::rt::RtRequest {
                priority: 90,
                cpu: None,
            });
            fuse::serve(&end, &shared);
        });
        mount(Path::new("tmpfs"), &dev, "tmpfs", 0).map_err(at("a /dev of its own"))?;
        for node in NODES {
            let real = Path::new("/dev").join(node);
            if real.exists() {
                bind(&real, &dev.join(node)).map_err(at("a device node"))?;
            }
        }
        for name in ["i2c-1", "gpiochip0"] {
            bind(&files.join(name), &dev.join(name)).map_err(at("an emulated device"))?;
        }
        std::fs::write(dev.join("gpiomem"), [0_u8; 4096]).map_err(at("registers"))?;
        let tree = Path::new("/sys/firmware");
        mount(
            &dev,
            Path::new("/dev"),
            "none",
            libc::MS_BIND | libc::MS_REC,
        )
        .map_err(at("/dev"))?;
        mount(Path::new("tmpfs"), tree, "tmpfs", 0).map_err(at("a device tree"))?;
        std::fs::create_dir_all(tree.join("devicetree/base")).map_err(at("a device tree"))?;
        std::fs::write(
            tree.join("devicetree/base/compatible"),
            "raspberrypi,3-model-b\0brcm,bcm2837\0",
        )
        .map_err(at("a device tree"))?;
        Ok(Self {
            world,
            connection,
            folder,
        })
    }

    /// The machine behind the files.
    pub fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The bus works again; calls that hung end with ETIMEDOUT, as from the driver of the controller.
    pub fn unhang(&self) {
        let hanging = {
            let mut world = self.world();
            world.bus.hangs = false;
            std::mem::take(&mut world.bus.hanging)
        };
        for unique in hanging {
            fuse::reply(&self.connection, unique, libc::ETIMEDOUT, &[]);
        }
    }

    /// A folder for results.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// A command of the program, in the namespace, with the line handles open.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(program());
        command
            .args(args)
            .env("NO_COLOR", "1")
            .env("RUST_BACKTRACE", "0");
        let handles: Vec<CString> = (0..HANDLES)
            .map(|n| text(self.folder.path().join(format!("files/lines{n}"))))
            .collect();
        // SAFETY: between fork and exec only open, dup2 and close are called, on strings made before;
        // all three are safe after a fork.
        unsafe {
            command.pre_exec(move || {
                for (path, fd) in handles.iter().zip(HANDLE_FD..) {
                    let opened = libc::open(path.as_ptr(), libc::O_RDWR);
                    if opened < 0 || libc::dup2(opened, fd) < 0 {
                        return Err(io::Error::last_os_error());
                    }
                    libc::close(opened);
                }
                Ok(())
            });
        }
        command
    }

    /// A command of the program, run by a user who is in no group. Program and board are copied to the `/dev` of the
    /// namespace, because others may not be able to read the folders of a checkout.
    pub fn command_of_a_stranger(&self, command: &str, board: &str) -> io::Result<Command> {
        let (there, file) = (Path::new("/dev/retroflex"), Path::new("/dev/board.toml"));
        if !there.exists() {
            std::fs::copy(program(), there)?;
        }
        std::fs::write(file, board)?;
        for (path, mode) in [(there, 0o755), (file, 0o644), (Path::new("/dev"), 0o755)] {
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))?;
        }
        let mut stranger = Command::new(there);
        stranger
            .args([command, "--board"])
            .arg(file)
            .current_dir("/")
            .env("NO_COLOR", "1")
            .uid(NOBODY)
            .gid(NOBODY);
        Ok(stranger)
    }
}

/// The program under test: `RETROFLEX_BIN`, or what cargo built beside the test.
pub fn program() -> PathBuf {
    std::env::var_os("RETROFLEX_BIN")
        .map_or_else(|| env!("CARGO_BIN_EXE_retroflex").into(), PathBuf::from)
}

/// Runs `body` in a thread with a rig, or prints why no rig can be built here.
pub fn on_a_pi(
    world: impl FnOnce() -> World + Send + 'static,
    body: impl FnOnce(&Rig) + Send + 'static,
) {
    let thread = std::thread::spawn(move || match Rig::start(world()) {
        Ok(rig) => body(&rig),
        Err(why) => {
            println!("skipped: an emulated Pi needs root, FUSE and mount namespaces; {why}")
        }
    });
    if let Err(panic) = thread.join() {
        std::panic::resume_unwind(panic);
    }
}
