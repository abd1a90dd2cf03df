//! Relations between the tables of a board: a board that contradicts itself is refused as it is read, with the place in
//! the file.

use crate::config::{Board, Header, PlantSection};
use crate::hardware::machine::ImuSection;
use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::{Backend, PinsConfig};
use crate::primitives::{Check, Checker, Invalid, Parameters, Table, join, shown};
use crate::supervisor::commission::homing::HomingMethod;

impl Check for Board {
    const TABLE: Option<&'static Table> = Some(<Self as Parameters>::TABLE);

    fn check(&self, to: &mut Checker) {
        let g = &self.geometry;
        let at_rest = "compare it with geometry.rest_length_mm";
        to.at("geometry.bellow_min_mm")
            .range(g.bellow_min_mm, 1.0..=g.rest_length_mm, "mm")
            .hint(at_rest);
        to.at("geometry.bellow_max_mm")
            .range(g.bellow_max_mm, g.rest_length_mm..=200.0, "mm")
            .hint(at_rest);
        let (socket, status) = (&self.service.socket, &self.service.status_socket);
        let paths = [
            ("socket", socket),
            ("status_socket", status),
            ("state", &self.service.state),
        ];
        for (key, path) in paths {
            let is_empty = path
                .as_ref()
                .is_some_and(|path| path.as_os_str().is_empty());
            to.at(&join("service", key))
                .holds(!is_empty, "the path is empty")
                .hint("name a file or folder, or leave the key out");
        }
        let same = socket.is_some() && socket == status;
        to.at("service.status_socket")
            .holds(!same, "the status socket is the command socket")
            .hint("give each its own path");
        priorities(self, to);
        power(self, to);
        motion(self, to);
        homing(self, to);
        if let Some(pins) = &self.pins {
            wiring(self, pins, to);
        }
        sensors(self, to);
        if let Some(section) = &self.plant {
            plant(section, to);
        }
    }
}

/// Takes a problem over.
fn pass_on(verdict: Result<(), Invalid>, to: &mut Checker) {
    if let Err(Invalid { key, problem, hint }) = verdict {
        to.refuse(&key, problem, &hint);
    }
}

fn priorities(board: &Board, to: &mut Checker) {
    let steps = board.stepper.priority;
    for (key, value) in [
        ("service.priority", board.service.priority),
        ("machine.imu_priority", board.machine.imu_priority),
    ] {
        let problem = format!("{value} is not below stepper.priority = {steps}");
        to.at(key)
            .holds(value == 0 || steps == 0 || value < steps, &problem)
            .hint("the step thread comes first: give it the highest priority");
    }
}

fn power(board: &Board, to: &mut Checker) {
    let (power, pitch_mm) = (&board.power, board.drive.pinion_pitch_diameter_mm);
    let (have, pressure) = (power.holding_torque_n_mm, board.limits.pressure_max_kpa);
    let needed = power.torque_n_mm(pressure, pitch_mm);
    let problem = format!(
        "{have} N·mm do not hold limits.pressure_max_kpa = {pressure} kPa, which turns the motor with {needed:.0} N·mm"
    );
    to.at("power.holding_torque_n_mm")
        .holds(have > needed, &problem)
        .hint("lower limits.pressure_max_kpa or use a stronger motor");
    if let Some(valve) = board.safety.relief_valve_kpa {
        let problem = format!(
            "a valve that opens at {valve} kPa leaks below limits.pressure_max_kpa = {pressure} kPa"
        );
        to.at("safety.relief_valve_kpa")
            .holds(valve > pressure, &problem)
            .hint("use a stiffer valve or lower limits.pressure_max_kpa");
        let stall = power.stall_kpa(pitch_mm);
        let problem = format!(
            "a valve that opens at {valve} kPa never opens: the motor makes {stall:.0} kPa at most"
        );
        to.at("safety.relief_valve_kpa")
            .holds(valve < stall, &problem)
            .hint("use a softer valve");
    }
}

/// Motion and pulses, each alone and together.
fn motion(board: &Board, to: &mut Checker) {
    let (motion, stepper) = (board.motion_limits(), &board.stepper);
    pass_on(stepper.validate(), to);
    if board.pins.is_some() {
        let (step_mm, period_s) = (board.drive.law().step_mm, board.machine.period_s);
        pass_on(stepper.validate_rate(&motion, step_mm), to);
        let (lead_ms, turn_ms) = (stepper.lead_ms, period_s * 1e3);
        let problem = format!("{lead_ms} ms is less than one turn of the loop, {turn_ms} ms");
        to.at("stepper.lead_ms")
            .holds(lead_ms * 1e-3 >= period_s, &problem)
            .hint("two turns of machine.period_s are a good lead");
    }
    let (stop_mm, travel_mm) = (motion.longest_stop_mm(), board.limits.travel_mm);
    let problem = format!(
        "a stop from full speed takes {stop_mm:.2} mm, more than the travel of {travel_mm} mm"
    );
    to.at("limits.travel_mm")
        .holds(stop_mm < travel_mm, &problem)
        .hint("lower motion.speed_max_mm_s or raise motion.acceleration_max_mm_s2");
}

fn homing(board: &Board, to: &mut Checker) {
    let (h, travel) = (&board.homing, board.limits.travel_mm);
    let fastest = board.motion.speed_max_mm_s.min(10.0);
    to.at("homing.speed_mm_s")
        .range(h.speed_mm_s, 0.1..=fastest, "mm/s")
        .hint("not faster than motion.speed_max_mm_s");
    to.at("homing.back_off_mm")
        .range(h.back_off_mm, 0.1..=travel, "mm")
        .hint("within limits.travel_mm");
    to.at("homing.repeat_max_mm")
        .range(h.repeat_max_mm, board.drive.law().step_mm..=1.0, "mm")
        .hint("at least one microstep");
    let hint = "where the switch closes, within limits.travel_mm";
    to.each("homing.at_mm", &h.at_mm, &(-travel..=travel), "mm", hint);
    if h.method == HomingMethod::Operator {
        return;
    }
    let without = |pins: &PinsConfig| pins.channels.iter().position(|c| c.home.is_none());
    let problem = match board.pins.as_ref().map(without) {
        None => "switches are selected, but the board has no [pins]".to_owned(),
        Some(Some(i)) => format!("switches are selected, but channel {} has none", i + 1),
        Some(None) => String::new(),
    };
    to.at("homing.method")
        .holds(problem.is_empty(), &problem)
        .hint("give every channel a `home` line, or write \"operator\"");
    let sided = h.at_mm.iter().all(|p| *p != 0.0);
    to.at("homing.at_mm")
        .holds(sided, "a switch at rest has no side to search on")
        .hint("write the position with its sign");
}

fn sensors(board: &Board, to: &mut Checker) {
    for (table, imu) in [("imu", &board.imu), ("base_imu", &board.base_imu)] {
        let Some(imu) = imu else { continue };
        let problem = format!("`{}` is not a device file", imu.bus);
        to.at(&format!("{table}.bus"))
            .holds(imu.bus.starts_with('/'), &problem)
            .hint("`ls /dev/i2c-*` lists the buses");
        let uses = board.pins.as_ref().map_or(vec![], PinsConfig::uses);
        for (i, line) in imu.bus_lines.iter().flatten().enumerate() {
            if let Some(u) = uses.iter().find(|u| u.pin == *line) {
                let key = format!("{table}.bus_lines.{i}");
                let used = shown(&format!("pins.{}", u.key));
                let problem = format!("line {line} is already {used}");
                to.refuse(&key, problem, "write SDA and SCL of the bus");
            }
        }
        let in_table = |e: Invalid| Invalid {
            key: e.key.replacen("imu", table, 1),
            ..e
        };
        pass_on(imu.chip.check().map_err(in_table), to);
    }
    pressure_sensors(board, to);
    if let (Some(tip), Some(base)) = (&board.imu, &board.base_imu) {
        let place = |imu: &ImuSection| (imu.bus.clone(), imu.chip.address());
        let (bus, address) = place(base);
        let problem = format!("{address:#04x} on {bus} is already the tip's IMU");
        to.at("base_imu.chip.address")
            .holds(place(tip) != (bus, address), &problem)
            .hint("pull the address pin of one sensor the other way, or use another bus");
    }
}

/// Every sensor has an address of its own, and the range of the part contains the limit.
fn pressure_sensors(board: &Board, to: &mut Checker) {
    let Some(p) = &board.pressure else { return };
    let imus = [("imu", &board.imu), ("base_imu", &board.base_imu)];
    for (i, address) in p.addresses.iter().enumerate() {
        let is_there = |imu: &ImuSection| imu.bus == p.bus && imu.chip.address() == *address;
        let mut imus = imus.iter();
        let imu = imus.find(|(_, imu)| imu.as_ref().is_some_and(is_there));
        let twin = p.addresses[..i].iter().position(|a| a == address);
        let twin = twin.map(|k| shown(&format!("pressure.addresses.{k}")));
        let other = twin.or(imu.map(|(table, _)| format!("{table}.chip.address")));
        if let Some(other) = other {
            let problem = format!("{address:#04x} on {} is already {other}", p.bus);
            let key = format!("pressure.addresses.{i}");
            to.refuse(&key, problem, "order the part with another address");
        }
    }
    let (limit, low, high) = (board.safety.pressure_max_kpa, p.low_kpa, p.high_kpa);
    let problem =
        format!("{low} to {high} kPa does not contain ±safety.pressure_max_kpa = ±{limit} kPa");
    to.at("pressure.high_kpa")
        .holds(high > limit && low < -limit, &problem)
        .hint("use a differential part with a larger range");
}

/// The wiring against the header: every line exists, has one use, and no other task.
fn wiring(board: &Board, pins: &PinsConfig, to: &mut Checker) {
    let chip = format!("`{}` is not a device file", pins.chip);
    to.at("pins.chip")
        .holds(pins.chip.starts_with('/'), &chip)
        .hint("`ls /dev/gpiochip*` lists the chips");
    for u in pins.uses() {
        header_line(board, pins.backend, &format!("pins.{}", u.key), u.pin, to);
    }
    pass_on(pins.validate(), to);
    pass_on(LineMap::new(pins, board.drive.microsteps).map(|_| ()), to);
}

/// A line of the header, or why not.
fn header_line(board: &Board, backend: Backend, key: &str, pin: u32, to: &mut Checker) {
    if board.machine.header == Header::Any && backend != Backend::Rppal {
        to.at(key)
            .range(f64::from(pin), 0.0..=511.0, "")
            .hint("`gpioinfo` lists the lines of a chip");
        return;
    }
    let numbers = "the header has GPIO 2 to 27 (Broadcom numbers, not positions on the header)";
    let mut imus = [&board.imu, &board.base_imu].into_iter().flatten();
    let on_bus_1 = imus.any(|imu| imu.bus == "/dev/i2c-1");
    let mut refuse = |problem: String| to.refuse(key, problem, numbers);
    match pin {
        0 | 1 => refuse(format!(
            "GPIO {pin} reads the identification EEPROM of an add-on board"
        )),
        2 | 3 if on_bus_1 => {
            let problem = format!("GPIO {pin} is SDA or SCL of /dev/i2c-1, where the IMU is");
            to.refuse(key, problem, "choose another line");
        }
        2..=27 => {}
        _ => refuse(format!("the header has no GPIO {pin}")),
    }
}

/// Reports what the built-in plant refuses.
fn plant(section: &PlantSection, to: &mut Checker) {
    to.at("plant.period_s")
        .range(section.period_s, 1e-4..=0.01, "s")
        .hint("0.001 is a loop at 1 kHz");
    let in_table = |e: Invalid| Invalid {
        key: join("plant", &e.key),
        ..e
    };
    pass_on(section.validate().map_err(in_table), to);
}
