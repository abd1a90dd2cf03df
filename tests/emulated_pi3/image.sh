# The guest: Debian's kernel and userland for arm64 as one initrd, and on top of it the files of this project.
#
# Sourced by .ci/emulated-pi3. The base is kept from run to run; the layer is made anew each time, from the
# units, rules and board file that the project ships, with the changes that `board_of_the_guest` and
# guest/drop-in.conf name.
# shellcheck shell=bash
: "${work:?}" "${root:?}"

# What the guest's Debian is made of.
# shellcheck disable=SC2034 # used by packages.sh
USERLAND=(systemd systemd-sysv udev dbus kmod procps util-linux bash coreutils passwd login mount sed grep base-files base-passwd dash
    libc-bin busybox)

# Packs a folder.
pack() { (cd "$1" && find . -mindepth 1 -print0 | cpio --quiet --null -o -H newc -R 0:0); }

# Kernel, device tree and base system.
base_image() {
    local base=$work/base link group release
    rm -rf "$base" && mkdir -p "$base/usr/bin" "$base/usr/sbin" "$base/usr/lib"
    for link in bin sbin lib; do
        ln -s "usr/$link" "$base/$link"
    done
    unpack "$base" userland
    mkdir -p "$base"/{proc,sys,dev,run,tmp,root,etc,usr/local/bin,var/log,var/tmp}
    cp "$base/usr/share/base-passwd/passwd.master" "$base/etc/passwd"
    cp "$base/usr/share/base-passwd/group.master" "$base/etc/group"
    for group in netdev:101 systemd-journal:102 kvm:103 render:104 sgx:105 input:106 messagebus:107; do
        echo "${group%:*}:x:${group#*:}:" >>"$base/etc/group"
    done
    echo 'messagebus:x:107:107::/nonexistent:/usr/sbin/nologin' >>"$base/etc/passwd"
    : >"$base/etc/machine-id"
    release=$(basename "$work"/kernel/lib/modules/*)
    # only what a Pi 3 of this emulator has: serial lines, pins, I²C, watchdog, and CUSE for a bus of our own
    mkdir -p "$base/lib/modules/$release"
    (cd "$work/kernel/lib/modules/$release" && cp -r --parents modules.builtin modules.builtin.modinfo modules.order kernel/drivers/i2c \
        kernel/fs/fuse kernel/drivers/watchdog/bcm2835_wdt.ko "$base/lib/modules/$release/")
    depmod -b "$base" "$release"
    rm -rf "$base"/usr/share/{doc,locale,man,info,lintian,zoneinfo,perl*} "$base"/usr/lib/*/{perl*,gconv} "$base"/usr/lib/udev/hwdb.d
    ln -s lib/systemd/systemd "$base/init"
    pack "$base" >"$work/base.cpio"
    cp "$work"/kernel/boot/vmlinuz-* "$work/vmlinuz"
    cp "$work"/kernel/usr/lib/linux-image-*/broadcom/bcm2837-rpi-3-b.dtb "$work/pi3.dtb"
    # no Bluetooth chip hangs on the first serial line here, so that it is a terminal
    fdtput -r "$work/pi3.dtb" /soc/serial@7e201000/bluetooth
}

# boards/pi3.toml, slowed down: an emulated processor is an order of magnitude slower than the real one, and
# stops for tens of milliseconds whenever the host has other work. Lines, chip, address, geometry, drive and
# gate are those of the Pi 3.
board_of_the_guest() {
    cat >"$1" <<'END'
base = "pi3"
[machine]
period_s = 0.02
[safety]
late_s = 1.0
stale_s = 5.0
following_for_s = 5.0
[stepper]
late_max_us = 100000.0
lead_ms = 100.0
poll_period_us = 10000.0
spin_us = 0.0
[imu.chip]
part = "icm20948"
rate_hz = 50.0
END
}

# The project's own files.
layer() {
    local top=$work/layer guest=$root/tests/emulated_pi3/guest unit
    rm -rf "$top" && mkdir -p "$top"/{usr/bin,usr/local/bin,etc/retroflex,etc/udev/rules.d,etc/modules-load.d}
    mkdir -p "$top"/usr/lib/{sysusers.d,tmpfiles.d,udev/rules.d} "$top"/etc/systemd/system/{retroflex.service.d,multi-user.target.wants}
    cp "$work/cross/$TARGET/release/retroflex" "$top/usr/bin/"
    cp "$work/cross/$TARGET/release/emulated-pi3-bus" "$guest/agent" "$top/usr/local/bin/"
    cp "$root/systemd/retroflex.service" "$top/etc/systemd/system/"
    cp "$root/systemd/retroflex.sysusers.conf" "$top/usr/lib/sysusers.d/retroflex.conf"
    cp "$root/systemd/retroflex.tmpfiles.conf" "$top/usr/lib/tmpfiles.d/retroflex.conf"
    cp "$root/systemd/60-retroflex.rules" "$top/usr/lib/udev/rules.d/"
    cp "$guest/drop-in.conf" "$top/etc/systemd/system/retroflex.service.d/emulated.conf"
    cp "$guest/emulated.rules" "$top/etc/udev/rules.d/70-emulated.rules"
    cp "$guest/agent.service" "$guest/bus.service" "$top/etc/systemd/system/"
    ln -s ../agent.service "$top/etc/systemd/system/multi-user.target.wants/agent.service"
    for unit in serial-getty@.service getty@.service console-getty.service systemd-logind.service systemd-udev-settle.service; do
        ln -s /dev/null "$top/etc/systemd/system/$unit"
    done
    printf 'i2c-dev\ni2c-bcm2835\nbcm2835_wdt\n' >"$top/etc/modules-load.d/emulated.conf"
    board_of_the_guest "$top/etc/retroflex/board.toml"
    cat "$work/base.cpio" <(pack "$top") >"$work/initrd"
}
