#!/bin/bash
# Fills a folder with photographs and textures for the renderer (`boxline render --photos FOLDER`), from two Debian packages.
#   photos.sh FOLDER
# The pictures stay out of the repository: their licences are printed at the end. A second run does nothing.
set -euo pipefail
folder="${1:?usage: photos.sh FOLDER}"
packages=(lomiri-wallpapers-16.04 openarena-081-textures)
smallest_bytes=60000 # what is smaller is an icon or a smear

mkdir -p "$folder"
folder="$(cd "$folder" && pwd)"
if [ -e "$folder/.complete" ]; then
    echo "photos: $(find "$folder" -name '*.jpg' | wc -l) pictures are in $folder already"
    cat "$folder/LICENCES.txt"
    exit 0
fi
for tool in apt-get dpkg-deb python3; do
    command -v "$tool" >/dev/null || { echo "photos: $tool is needed" >&2; exit 1; }
done
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
if ! apt-get download "${packages[@]}"; then
    cat >&2 <<'END'
photos: apt-get cannot download the packages. They are in Debian's main archive; where it is not among the sources, add
    deb http://deb.debian.org/debian stable main
(with Debian's keyring: package debian-archive-keyring), run `apt-get update` and start this script again.
END
    exit 1
fi
for package in "${packages[@]}"; do
    dpkg-deb -x "$package"_*.deb "$package"
done

# A pk3 is a zip; a picture's name there becomes its path, so that two of the same name do not meet.
python3 - "$work" "$folder" "$smallest_bytes" <<'END'
import pathlib, shutil, sys, zipfile
work, folder, smallest = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), int(sys.argv[3])
for picture in sorted(work.glob("lomiri*/usr/share/backgrounds/*.jpg")):
    shutil.copyfile(picture, folder / picture.name)
for archive in sorted(work.glob("openarena*/usr/share/games/openarena/**/*.pk3")):
    with zipfile.ZipFile(archive) as pk3:
        for entry in pk3.infolist():
            if entry.filename.lower().endswith(".jpg") and entry.file_size > smallest:
                (folder / ("oa-" + entry.filename.replace("/", "-"))).write_bytes(pk3.read(entry))
END
for package in "${packages[@]}"; do
    echo "== $package: $(grep -ohiE '^License: .*' "$package/usr/share/doc/$package/copyright" | sort -u | sed 's/^[^:]*: *//' | paste -sd ';' | sed 's/;/; /g')"
done >"$folder/LICENCES.txt"
for package in "${packages[@]}"; do
    cp "$package/usr/share/doc/$package/copyright" "$folder/$package.copyright"
done
touch "$folder/.complete"
echo "photos: $(find "$folder" -name '*.jpg' | wc -l) pictures in $folder, $(du -sh "$folder" | cut -f1); licences (in full in *.copyright there):"
cat "$folder/LICENCES.txt"
