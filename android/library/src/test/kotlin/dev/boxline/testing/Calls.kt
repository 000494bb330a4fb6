package dev.boxline.testing

import dev.boxline.BoxMeter
import kotlinx.coroutines.runBlocking

/** So many calls of one kind and nothing else, for who counts what a call costs: `measure 3` or `view 3`. */
internal fun main(arguments: Array<String>) = runBlocking {
    val (kind, calls) = arguments
    val (a, b) = listOf("a", "b").map { Recordings.frame("b02", it) }
    BoxMeter.open(Recordings.calibration).use { meter ->
        repeat(calls.toInt()) { if (kind == "measure") meter.measureBox(a, b) else meter.view(a) }
    }
}
