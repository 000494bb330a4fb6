#!/bin/sh
# Runs Gradle on android/, in the version of gradle-wrapper/gradle-wrapper.properties. The wrapper's own program is no file of this
# repository: the first call takes it from a package of the npm registry and checks its sum.
set -eu
root=$(cd "$(dirname "$0")" && pwd)
jar=$root/gradle-wrapper/gradle-wrapper.jar
sum=55243ef57851f12b070ad14f7f5bb8302daceeebc5bce5ece5fa6edb23e1145c
if [ ! -e "$jar" ]; then
  scratch=$(mktemp -d)
  trap 'rm -rf "$scratch"' EXIT
  (cd "$scratch" && tar xzf "$(npm pack --silent @react-native-community/template@0.87.2)" package/template/android/gradle/wrapper/gradle-wrapper.jar)
  mv "$scratch/package/template/android/gradle/wrapper/gradle-wrapper.jar" "$jar"
fi
if command -v sha256sum >/dev/null; then found=$(sha256sum "$jar"); else found=$(shasum -a 256 "$jar"); fi
[ "${found%% *}" = "$sum" ] || {
  echo "$jar: its sum is ${found%% *}, $sum is needed" >&2
  exit 1
}
exec "${JAVA_HOME:+$JAVA_HOME/bin/}java" -cp "$jar" org.gradle.wrapper.GradleWrapperMain -p "$root/android" "$@"
