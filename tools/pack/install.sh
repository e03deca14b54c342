#!/bin/sh
# Installs @role@ @name@ of site @site@ on this machine:
#     sudo sh install.sh
# Into a folder, to see what it does, without root, user or service:
#     DESTDIR=/tmp/try sh install.sh
set -eu
cd "$(dirname "$0")"
root=${DESTDIR:-}
program=$root@program_at@
files=$root@files_at@
units=$root/etc/systemd/system

stop() {
    echo "install.sh: $1" >&2
    exit 1
}

[ -n "$root" ] || [ "$(id -u)" = 0 ] || stop "needs root: sudo sh install.sh"
@machine_check@
python3 -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' ||
    stop "needs Python 3.11 or later: apt install python3-venv"

echo "1 the program, from the wheel here; what it needs comes from your package index: $program"
python3 -m venv "$program"
pip() { "$program/bin/pip" install --quiet --disable-pip-version-check "$@"; }
pip -c constraints.txt './@wheel@@extras@'
pip --force-reinstall --no-deps ./@wheel@  # where another of the same version was

echo "2 the site's files and this machine's keys: $files"
mkdir -p "$files"
cp -Rp site/. "$files"
chmod 700 "$files"

echo "3 the unit: $units/@unit@.service"
mkdir -p "$units"
cp @unit@.service "$units"

if [ -n "$root" ]; then
    echo "not done in a folder: the user, the service"
    exit 0
fi

echo "4 the user and the service: @service@"
systemd-sysusers "$PWD/trigpoint.conf"
chown -R trigpoint: "$files"
systemctl daemon-reload
systemctl enable @service@
systemctl restart @service@
echo "done; what it says: journalctl -fu @service@"
