package android.view

/** Stands for Android's class where tests run without it. */
internal open class Surface
