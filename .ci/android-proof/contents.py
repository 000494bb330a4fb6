"""Prints what is in an AAR or APK, with sizes, and fails if it is not exactly what belongs there: contents.py aar|apk FILE."""
import io, re, sys, zipfile

ABIS = ("arm64-v8a", "x86_64")
LIBRARIES = ("libboxline_jni.so", "libusb1.0.so")
AAR = {
    "AndroidManifest.xml", "R.txt", "classes.jar", "proguard.txt", "res/xml/boxline_device_filter.xml",
    "META-INF/LICENSE", "META-INF/NOTICE", "META-INF/LGPL-2.1.txt", "META-INF/com/android/build/gradle/aar-metadata.properties",
} | {f"jni/{abi}/{name}" for abi in ABIS for name in LIBRARIES}
APK = {"AndroidManifest.xml", "resources.arsc", "classes.dex"} | {f"lib/{abi}/{name}" for abi in ABIS for name in LIBRARIES}


def problems_of(kind, archive):
    names = set(archive.namelist())
    wanted = AAR if kind == "aar" else APK
    for name in sorted(wanted - names):
        yield f"{name} is missing"
    # An APK also has resources, and its signature.
    extra = {n for n in names - wanted if kind == "aar" or not re.match(r"(res|META-INF)/", n)}
    for name in sorted(extra):
        yield f"{name} does not belong there"
    for name in sorted(names):
        if name.endswith(".so") and b"NativeTesting" in archive.read(name):
            yield f"{name} has entry points for tests"
    if kind == "aar":
        if "permission.INTERNET" in archive.read("AndroidManifest.xml").decode():
            yield "the manifest asks for the internet"
        classes = zipfile.ZipFile(io.BytesIO(archive.read("classes.jar"))).namelist()
        for kept in re.findall(r"class ([\w.]+)", archive.read("proguard.txt").decode()):
            if kept.replace(".", "/") + ".class" not in classes:
                yield f"proguard.txt keeps {kept}, which is not in classes.jar"


def main(kind, path):
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            print(f"   {info.file_size:9} {info.compress_size:9}  {info.filename}")
        problems = list(problems_of(kind, archive))
    for text in problems:
        print(f"   {text}")
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
