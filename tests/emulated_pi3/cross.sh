# The program as released, for a Raspberry Pi: `cargo build --release --target aarch64-unknown-linux-gnu`.
#
# Sourced by .ci/emulated-pi3. Uses the target's standard library of the toolchain in use where it has one,
# else Debian's compiler for its web browsers, which is new enough, unpacked and not installed.
# shellcheck shell=bash
: "${work:?}" "${root:?}"

TARGET=aarch64-unknown-linux-gnu

# Debian's rustc with the standard libraries of both architectures, unless the toolchain has the target.
fetch_rust() {
    rm -f "$work/rustc"
    [ ! -d "$(rustc --print target-libdir --target "$TARGET")" ] || return 0
    local names
    names=$(apt_in tools -s install --no-install-recommends rustc-web libstd-rust-web-dev 2>/dev/null | awk '$1 == "Inst" { print $2 }')
    [ -n "$names" ] || skip "no rustc-web among the packages, and the toolchain cannot compile for $TARGET"
    mkdir -p "$work/apt/cache-rust"
    # shellcheck disable=SC2086 # a list of names
    (cd "$work/apt/cache-rust" && apt_in tools download -qq $names libstd-rust-web-dev:arm64) || skip "a compiler for $TARGET cannot be had"
    unpack "$work/rust" rust
    debian_rustc
    local have need
    have=$("$work/rustc" --version | cut -d' ' -f2)
    need=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' "$root/Cargo.toml")
    dpkg --compare-versions "$have" ge "$need" || skip "Debian's compiler for $TARGET is $have, $need is needed"
}

# Debian's compiler, with its own libraries for it alone.
debian_rustc() {
    local rust=$work/rust/usr
    printf '#!/bin/sh\nLD_LIBRARY_PATH="%s" exec "%s" "$@"\n' "$rust/lib/x86_64-linux-gnu:$rust/lib" "$rust/bin/rustc" >"$work/rustc"
    chmod +x "$work/rustc"
}

# Runs cargo for the target; nothing of it is left for the cargo of this machine.
cross_cargo() (
    [ ! -x "$work/rustc" ] || export RUSTC=$work/rustc
    export CARGO_TARGET_DIR=$work/cross CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
    cargo build --release --target "$TARGET" "$@"
)

# The program: every input is as it is released.
cross_build() { cross_cargo --bin retroflex; }

# The bus of the guest, a package of its own made from the same parts; its library need not be fast.
bus_build() {
    local bus=$work/bus
    mkdir -p "$bus"
    {
        printf '[package]\nname = "emulated-pi3-bus"\nversion = "0.0.0"\nedition = "2024"\n\n[workspace]\n\n'
        printf '[[bin]]\nname = "emulated-pi3-bus"\npath = "%s"\n\n' "$root/tests/emulated_pi3/bus/main.rs"
        printf '[dependencies]\nretroflex = { path = "%s" }\n' "$root"
        sed -n -E '/^(libc|nalgebra|embedded-hal|rand|rand_distr|thiserror) = /p' "$root/Cargo.toml"
        sed -n '/^\[profile.release\]/,/^$/p' "$root/Cargo.toml"
        printf '\n[profile.release.package.retroflex]\nopt-level = 1\n'
    } >"$bus/Cargo.toml"
    cp "$root/Cargo.lock" "$bus/Cargo.lock"
    cross_cargo --manifest-path "$bus/Cargo.toml"
}

# What the bus is made from.
bus_inputs() {
    find "$root"/src/hardware/imu "$root"/src/hardware/rt.rs "$root"/tests/fake_imu "$root"/tests/emulated_pi/{fuse,i2c}.rs "$root"/tests/emulated_pi3/{bus/main,wire}.rs \
        "$root/Cargo.lock" "$work/packages.key" -type f -exec sha256sum {} + | sort
}
