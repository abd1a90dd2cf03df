# What the emulated Pi 3 is made from: Debian's packages, found by apt under their names of today.
#
# Sourced by .ci/emulated-pi3. apt works on a folder of its own with the sources of this machine, the
# architecture arm64 and, where the QEMU of this release is too old, its backports: nothing in /etc/apt
# changes. QEMU, the cross linker, cpio, depmod and fdtput are installed, everything else is unpacked into
# the work folder.
# shellcheck shell=bash
: "${work:?}" "${codename:?}"

# The first QEMU whose raspi3b has I²C controllers.
QEMU_MIN=1:9

# apt with the folder of its own; $1 is the name of a cache for what is downloaded.
apt_in() {
    local cache=$work/apt/cache-$1
    shift
    mkdir -p "$cache/partial" "$work/apt/lists/partial"
    apt-get -o Dir::Etc::SourceList=/dev/null -o Dir::Etc::SourceParts="$work/apt/parts" -o Dir::State::Lists="$work/apt/lists" \
        -o Dir::Cache::Archives="$cache" -o Dir::Cache::pkgcache= -o Dir::Cache::srcpkgcache= \
        -o APT::Architectures::=amd64 -o APT::Architectures::=arm64 -o APT::Sandbox::User=root "$@"
}

# What apt knows of a package.
apt_knows() {
    apt-cache -o Dir::Etc::SourceList=/dev/null -o Dir::Etc::SourceParts="$work/apt/parts" -o Dir::State::Lists="$work/apt/lists" \
        -o Dir::Cache::pkgcache= -o Dir::Cache::srcpkgcache= -o APT::Architectures::=amd64 -o APT::Architectures::=arm64 -o APT::Sandbox::User=root "$@"
}

# The version of a package that would be installed from a release; nothing where it cannot be.
version_of() {
    { apt_in tools -s -t "$2" install --no-install-recommends "$1" 2>/dev/null || true; } |
        sed -n "s/^Inst $1 \[\?[^(]*(\([^ ]*\) .*/\1/p" | head -1
}

# The sources of this machine, and backports from the place where its release comes from.
apt_sources() {
    local parts=$work/apt/parts
    rm -rf "$parts" && mkdir -p "$parts"
    cp -r /etc/apt/sources.list.d/. "$parts/"
    [ ! -f /etc/apt/sources.list ] || cp /etc/apt/sources.list "$parts/machine.list"
    grep -rqs -- "$codename-backports" "$parts" && return
    local from
    from=$(apt-get indextargets --format "\$(REPO_URI) \$(RELEASE)" "Created-By: Packages" | awk -v c="$codename" '$2 == c { print $1; exit }')
    [ -n "$from" ] || skip "no source of $codename among this machine's apt sources"
    echo "deb $from $codename-backports main" >"$parts/backports.list"
}

# Downloads packages without installing them, and unpacks them into a folder.
unpack() {
    local into=$1 cache=$2 deb
    mkdir -p "$into"
    for deb in "$work/apt/cache-$cache"/*.deb; do
        # folders that are links stay links: /lib is /usr/lib
        dpkg --fsys-tarfile "$deb" | tar -x -C "$into" --keep-directory-symlink
    done
}

# What has to run on this machine is installed, where it is not yet.
install_tools() {
    local missing=() version from=$codename have
    command -v cpio >/dev/null || missing+=(cpio)
    command -v depmod >/dev/null || missing+=(kmod)
    command -v fdtput >/dev/null || missing+=(device-tree-compiler)
    command -v aarch64-linux-gnu-gcc >/dev/null && [ -e /usr/aarch64-linux-gnu/lib/libc.so.6 ] || missing+=(gcc-aarch64-linux-gnu libc6-dev-arm64-cross)
    have=$(qemu-system-aarch64 --version 2>/dev/null | sed -n 's/^QEMU emulator version \([0-9.]*\).*/1:\1/p' || true)
    if dpkg --compare-versions "${have:-0}" lt "$QEMU_MIN"; then
        version=$(version_of qemu-system-arm "$from")
        if dpkg --compare-versions "${version:-0}" lt "$QEMU_MIN"; then
            from=$codename-backports
            version=$(version_of qemu-system-arm "$from")
        fi
        dpkg --compare-versions "${version:-0}" ge "$QEMU_MIN" || skip "no QEMU with a Pi 3 whose I²C works ($QEMU_MIN) among the packages"
        missing+=("qemu-system-arm/$from" "qemu-system-common/$from" "qemu-system-data/$from")
    fi
    [ ${#missing[@]} -eq 0 ] && return
    DEBIAN_FRONTEND=noninteractive apt_in tools install -y -qq --no-install-recommends "${missing[@]}" >"$work/install.log" 2>&1 ||
        { tail -5 "$work/install.log"; skip "${missing[*]} cannot be installed"; }
}

# Everything that comes from outside. Each part is fetched once.
fetch() {
    apt_sources
    apt_in tools update -qq -o APT::Update::Error-Mode=any >"$work/update.log" 2>&1 || { tail -5 "$work/update.log"; skip "the package lists cannot be had"; }
    install_tools
    local kernel
    kernel=$(apt_knows depends linux-image-arm64:arm64 | sed -n 's/^ *Depends: \(linux-image-[0-9][^ ]*\)$/\1/p' | head -1)
    [ -n "$kernel" ] || skip "no kernel for arm64 among the packages"
    rm -rf "$work"/{kernel,userland,rust} "$work"/apt/cache-{kernel,userland,rust}
    (mkdir -p "$work/apt/cache-kernel" && cd "$work/apt/cache-kernel" && apt_in tools download -qq "$kernel") || skip "$kernel cannot be had"
    unpack "$work/kernel" kernel
    apt_in userland -o APT::Architecture=arm64 -o Dir::State::status=/dev/null -qq -y -d --no-install-recommends install "${USERLAND[@]}" \
        >"$work/userland.log" 2>&1 || { tail -5 "$work/userland.log"; skip "the userland for arm64 cannot be had"; }
    fetch_rust
}
