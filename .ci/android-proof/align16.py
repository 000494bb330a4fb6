"""Puts the .so files of an APK at 16 KiB: align16.py IN OUT, or align16.py check FILE. zipalign of Debian knows 4 KiB only."""
import struct, sys, zipfile

PAGE = 16384


def data_offset(file, info):
    file.seek(info.header_offset + 26)
    name, extra = struct.unpack("<HH", file.read(4))
    return info.header_offset + 30 + name + extra


def check(path):
    with open(path, "rb") as file, zipfile.ZipFile(path) as archive:
        wrong = [i.filename for i in archive.infolist()
                 if i.filename.endswith(".so") and (i.compress_type != 0 or data_offset(file, i) % PAGE)]
    if wrong:
        sys.exit(f"{path}: not stored at 16 KiB: {', '.join(wrong)}")


def rewrite(source, target):
    with zipfile.ZipFile(source) as old, open(target, "wb") as file, zipfile.ZipFile(file, "w") as new:
        for info in old.infolist():
            made = zipfile.ZipInfo(info.filename, (1980, 1, 1, 0, 0, 0))
            made.compress_type, made.external_attr = info.compress_type, info.external_attr
            if info.filename.endswith(".so"):
                made.compress_type = zipfile.ZIP_STORED
                used = file.tell() + 30 + len(info.filename.encode()) + 6
                # Extra field 0xd935: alignment, then zeros.
                made.extra = struct.pack("<HHH", 0xD935, 2 + -used % PAGE, PAGE) + bytes(-used % PAGE)
            new.writestr(made, old.read(info))


if __name__ == "__main__":
    check(sys.argv[2]) if sys.argv[1] == "check" else rewrite(*sys.argv[1:])
