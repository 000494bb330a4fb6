plugins {
    id("com.android.application")
    id("org.jetbrains.kotlin.android")
}

android {
    namespace = "dev.boxline.sample"
    compileSdk = 36

    defaultConfig {
        applicationId = "dev.boxline.sample"
        minSdk = 24
        targetSdk = 35
        versionCode = 1
        versionName = providers.gradleProperty("boxline.version").get()
    }
    buildTypes {
        // Minified, so that the library's keep rules are in effect where they are tried.
        release {
            isMinifyEnabled = true
            proguardFiles(getDefaultProguardFile("proguard-android-optimize.txt"))
        }
    }
    compileOptions {
        sourceCompatibility = JavaVersion.VERSION_1_8
        targetCompatibility = JavaVersion.VERSION_1_8
    }
    testOptions.unitTests.isIncludeAndroidResources = true
}

dependencies {
    implementation(project(":library"))
    implementation("org.jetbrains.kotlinx:kotlinx-coroutines-android:1.10.2") // the main thread as a dispatcher
    testImplementation("junit:junit:4.13.2")
    testImplementation("org.robolectric:robolectric:4.14.1")
}
