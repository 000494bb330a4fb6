// The AAR: Kotlin, and for each kind of phone libboxline_jni.so (by cargo-ndk) and libusb1.0.so.
import org.jetbrains.kotlin.gradle.dsl.ExplicitApiMode
import org.jetbrains.kotlin.gradle.dsl.JvmTarget

plugins {
    id("com.android.library")
    id("org.jetbrains.kotlin.android")
    `maven-publish`
}

// What Android calls a processor, what Rust calls it, what the NDK's compiler is called by.
val abis = mapOf(
    "arm64-v8a" to ("aarch64-linux-android" to "aarch64-linux-android24-clang"),
    "armeabi-v7a" to ("armv7-linux-androideabi" to "armv7a-linux-androideabi24-clang"),
    "x86_64" to ("x86_64-linux-android" to "x86_64-linux-android24-clang"),
)
val repository = rootDir.parentFile
val nativeFolder = layout.buildDirectory.dir("native")

android {
    namespace = "dev.boxline"
    compileSdk = 36
    ndkVersion = "28.2.13676358"

    defaultConfig {
        minSdk = 24
        consumerProguardFiles("keep.pro")
        ndk { abiFilters += abis.keys }
    }
    compileOptions {
        sourceCompatibility = JavaVersion.VERSION_1_8
        targetCompatibility = JavaVersion.VERSION_1_8
    }
    sourceSets["main"].jniLibs.srcDir(nativeFolder)
    sourceSets["main"].resources.srcDir(layout.buildDirectory.dir("licences"))
    publishing { singleVariant("release") { withSourcesJar() } }
}

kotlin {
    explicitApi = ExplicitApiMode.Strict
    compilerOptions {
        jvmTarget.set(JvmTarget.JVM_1_8)
        allWarningsAsErrors.set(true)
    }
}

dependencies {
    api("org.jetbrains.kotlinx:kotlinx-coroutines-core:1.10.2")
    testImplementation("junit:junit:4.13.2")
}

// libusb first: libboxline_jni.so is linked against it.
val libusb = abis.map { (abi, names) ->
    tasks.register<Exec>("libusb-$abi") {
        val out = nativeFolder.get().file("$abi/libusb1.0.so").asFile
        val host = if (System.getProperty("os.name").startsWith("Mac")) "darwin-x86_64" else "linux-x86_64"
        val compiler = androidComponents.sdkComponents.ndkDirectory.get().file("toolchains/llvm/prebuilt/$host/bin/${names.second}")
        inputs.file(repository.resolve("Cargo.lock"))
        outputs.file(out)
        commandLine(repository.resolve("android/native/libusb").path, compiler.asFile.path, out.path)
    }
}

val rust = abis.map { (abi, names) ->
    tasks.register<Exec>("rust-$abi") {
        dependsOn(libusb)
        val folder = nativeFolder.get().dir(abi).asFile.path
        val triple = names.first
        workingDir = repository
        environment("ANDROID_NDK_HOME", androidComponents.sdkComponents.ndkDirectory.get().asFile.path)
        environment("RUSTFLAGS", "-Clink-arg=-Wl,-z,max-page-size=16384")
        val network = if (providers.gradleProperty("boxline.network").get().toBoolean()) emptyList() else listOf("--no-default-features")
        commandLine(
            listOf(
                "cargo", "ndk", "--target", abi, "--platform", "24", "--output-dir", nativeFolder.get().asFile.path,
                "build", "--locked", "--release", "--package", "boxline-jni", "--lib",
                "--config", "target.$triple.'usb-1.0'.rustc-link-lib=['usb1.0']",
                "--config", "target.$triple.'usb-1.0'.rustc-link-search=['native=$folder']",
            ) + network,
        )
    }
}

val licences = tasks.register<Copy>("licences") {
    dependsOn(libusb)
    from(repository.resolve("LICENSE"), repository.resolve("android/NOTICE"), nativeFolder.map { it.file("arm64-v8a/LGPL-2.1.txt") })
    into(layout.buildDirectory.dir("licences/META-INF/dev.boxline"))
}

tasks.named("preBuild") { dependsOn(rust, licences) }

publishing {
    publications {
        register<MavenPublication>("release") {
            groupId = "dev.boxline"
            artifactId = "boxline-android"
            version = providers.gradleProperty("boxline.version").get()
            afterEvaluate { from(components["release"]) }
            pom {
                name = "boxline"
                description = "Measures boxes with a phone and a head of a camera and four lasers"
                licenses {
                    license {
                        name = "Apache-2.0"
                        url = "https://www.apache.org/licenses/LICENSE-2.0"
                    }
                    license {
                        name = "LGPL-2.1-or-later (libusb1.0.so)"
                        url = "https://www.gnu.org/licenses/old-licenses/lgpl-2.1.html"
                    }
                }
            }
        }
    }
}
