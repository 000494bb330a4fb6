"""Puts an AAR or an unsigned APK together: package.py aar|apk TARGET ROOT BUILT. Times are fixed, so the same parts give the same bytes."""
import pathlib, sys, zipfile

TIME = (1980, 1, 1, 0, 0, 0)
ABIS = ("arm64-v8a", "x86_64")


def add(archive, name, data, method=zipfile.ZIP_DEFLATED):
    info = zipfile.ZipInfo(name, TIME)
    info.compress_type, info.external_attr = method, 0o644 << 16
    archive.writestr(info, data)


def jar(path):
    """Without the names of source modules, which Gradle leaves out of classes.jar too."""
    import io
    bytes_ = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(bytes_, "w") as new:
        for name in sorted(n for n in old.namelist() if n.endswith(".class") or n.endswith(".kotlin_module")):
            add(new, name, old.read(name))
    return bytes_.getvalue()


def libraries(archive, folder, built, method):
    for abi in ABIS:
        for library in sorted((built / abi).glob("*.so")):
            add(archive, f"{folder}/{abi}/{library.name}", library.read_bytes(), method)


def aar(target, root, built):
    source = root / "android/library"
    with zipfile.ZipFile(target, "w") as archive:
        add(archive, "AndroidManifest.xml", (source / "src/main/AndroidManifest.xml").read_bytes())
        add(archive, "R.txt", "int xml boxline_device_filter 0x0\n")
        add(archive, "META-INF/com/android/build/gradle/aar-metadata.properties",
            "aarFormatVersion=1.0\naarMetadataVersion=1.0\nminCompileSdk=1\nminCompileSdkExtension=0\nminAndroidGradlePluginVersion=1.0.0\n")
        add(archive, "classes.jar", jar(built / "library.jar"))
        add(archive, "proguard.txt", (source / "keep.pro").read_bytes())
        for licence in (root / "LICENSE", root / "android/NOTICE", built / "arm64-v8a/LGPL-2.1.txt"):
            add(archive, f"META-INF/{licence.name}", licence.read_bytes())
        for resource in sorted((source / "src/main/res").rglob("*.xml")):
            add(archive, str(resource.relative_to(source / "src/main")), resource.read_bytes())
        libraries(archive, "jni", built, zipfile.ZIP_DEFLATED)


def apk(target, root, built):
    with zipfile.ZipFile(built / "base.apk") as base, zipfile.ZipFile(target, "w") as archive:
        for info in base.infolist():
            add(archive, info.filename, base.read(info), info.compress_type)
        for dex in sorted((built / "dex").glob("*.dex")):
            add(archive, dex.name, dex.read_bytes())
        libraries(archive, "lib", built, zipfile.ZIP_STORED)


if __name__ == "__main__":
    kind, target, root, built = sys.argv[1], *map(pathlib.Path, sys.argv[2:])
    {"aar": aar, "apk": apk}[kind](target, root, built)
