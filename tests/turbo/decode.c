/* Processor time of libjpeg-turbo for the two JPEGs of a box, from bytes in memory to RGB in memory: the referee of rust/SPEED.md.
 *
 *     cc -O2 tests/turbo/decode.c -o decode -ljpeg && ./decode tests/data/b02 [loops]
 *
 * On Debian libjpeg is libjpeg-turbo with its SIMD code (libjpeg62-turbo-dev); one thread. The memory of the pictures is taken and
 * given back each time, as a measurement does. `cargo run --release -p boxline-edgenet --example pair_time` is the other side: run them in
 * turn. */
#include <stdio.h>
#include <stdlib.h>
#include <jpeglib.h>
#include <time.h>

static double processor_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec * 1e3 + t.tv_nsec * 1e-6;
}

static void decode(const unsigned char *bytes, unsigned long size) {
    struct jpeg_decompress_struct jpeg;
    struct jpeg_error_mgr errors;
    jpeg.err = jpeg_std_error(&errors); /* ends the program where the file is broken */
    jpeg_create_decompress(&jpeg);
    jpeg_mem_src(&jpeg, bytes, size);
    jpeg_read_header(&jpeg, TRUE);
    jpeg.out_color_space = JCS_RGB;
    jpeg_start_decompress(&jpeg);
    size_t stride = (size_t)jpeg.output_width * 3;
    unsigned char *rgb = malloc(stride * jpeg.output_height);
    if (!rgb)
        exit(1);
    while (jpeg.output_scanline < jpeg.output_height) {
        JSAMPROW row = rgb + stride * jpeg.output_scanline;
        jpeg_read_scanlines(&jpeg, &row, 1);
    }
    jpeg_finish_decompress(&jpeg);
    jpeg_destroy_decompress(&jpeg);
    free(rgb);
}

int main(int count, char **arguments) {
    if (count < 2) {
        fprintf(stderr, "usage: decode FOLDER [LOOPS]\n");
        return 2;
    }
    static unsigned char bytes[2][8 << 20];
    unsigned long size[2];
    for (int i = 0; i < 2; i++) {
        char path[4096];
        snprintf(path, sizeof path, "%s/%c.jpg", arguments[1], 'a' + i);
        FILE *file = fopen(path, "rb");
        if (!file) {
            perror(path);
            return 1;
        }
        size[i] = fread(bytes[i], 1, sizeof bytes[i], file);
        fclose(file);
    }
    int loops = count > 2 ? atoi(arguments[2]) : 15;
    double least = 1e9;
    for (int loop = 0; loop < loops; loop++) {
        double start = processor_ms();
        decode(bytes[0], size[0]);
        decode(bytes[1], size[1]);
        double ms = processor_ms() - start;
        least = ms < least ? ms : least;
    }
    printf("decode both, libjpeg-turbo: least %.1f ms of %d\n", least, loops);
    return 0;
}
