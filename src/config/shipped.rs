//! The files that come with the program: boards by name, gains and the paper's calibration.

/// The board of the built-in plant, on which everything runs that is not given another.
pub const SIM: (&str, &str) = ("boards/sim.toml", include_str!("../../boards/sim.toml"));
/// A healthy tip, on which the service runs that is not given another board.
pub const DEMO: (&str, &str) = ("boards/demo.toml", include_str!("../../boards/demo.toml"));
/// The paper's calibration.
pub const PAPER: (&str, &str) = ("calib/paper.toml", include_str!("../../calib/paper.toml"));
/// The default gains.
pub const GAINS: (&str, &str) = ("boards/gains.toml", include_str!("../../boards/gains.toml"));

/// Every board with its text.
pub const BOARDS: [(&str, &str); 8] = [
    ("sim", SIM.1),
    ("demo", DEMO.1),
    ("pi3", include_str!("../../boards/pi3.toml")),
    ("pi4", include_str!("../../boards/pi4.toml")),
    ("pi5", include_str!("../../boards/pi5.toml")),
    (
        "pi5-lsm6dsv16x",
        include_str!("../../boards/pi5-lsm6dsv16x.toml"),
    ),
    ("pi-zero2w", include_str!("../../boards/pi-zero2w.toml")),
    (
        "linux-gpiochip",
        include_str!("../../boards/linux-gpiochip.toml"),
    ),
];

/// The text of a board.
pub fn board(name: &str) -> Option<&'static str> {
    let found = BOARDS.iter().find(|(n, _)| *n == name);
    found.map(|(_, text)| *text)
}

/// Their names, for messages.
pub fn names() -> String {
    BOARDS.map(|(name, _)| name).join(", ")
}
