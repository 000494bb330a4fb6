// Where Android's C library differs from glibc, for the functions that our libraries import: `bionic_NAME` stands in for NAME.
// What is not here goes to glibc as it is. For proof on a Linux machine only.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

struct row { const char *name; void **at; };

void *shim_stderr(void) { return stderr; }

int *bionic___errno(void) { return &errno; }

_Noreturn void bionic___assert2(const char *file, int line, const char *function, const char *what) {
  fprintf(stderr, "%s:%d: %s: %s\n", file, line, function, what);
  abort();
}

// Android counts its names from its own list.
long bionic_sysconf(int name) {
  switch (name) {
    case 0x27: case 0x28: return sysconf(_SC_PAGESIZE);
    case 0x60: return sysconf(_SC_NPROCESSORS_CONF);
    case 0x61: return sysconf(_SC_NPROCESSORS_ONLN);
    case 0x06: return sysconf(_SC_CLK_TCK);
    case 0x62: return sysconf(_SC_PHYS_PAGES);
    case 0x48: return sysconf(_SC_GETPW_R_SIZE_MAX);
    default: fprintf(stderr, "[shim] sysconf(%#x) is not translated\n", name); errno = EINVAL; return -1;
  }
}

// No property is set.
int bionic___system_property_get(const char *name, char *value) { (void)name; *value = 0; return 0; }

// POSIX's, not GNU's.
int bionic_strerror_r(int code, char *text, size_t bytes) {
  extern int __xpg_strerror_r(int, char *, size_t);
  return __xpg_strerror_r(code, text, bytes);
}

int bionic___android_log_write(int level, const char *tag, const char *text) { return fprintf(stderr, "log %d %s: %s\n", level, tag, text); }

int bionic___android_log_buf_write(int buffer, int level, const char *tag, const char *text) { (void)buffer; return bionic___android_log_write(level, tag, text); }

int bionic___android_log_print(int level, const char *tag, const char *format, ...) {
  va_list values;
  va_start(values, format);
  fprintf(stderr, "log %d %s: ", level, tag);
  int bytes = vfprintf(stderr, format, values);
  fputc('\n', stderr);
  va_end(values);
  return bytes;
}

int bionic___android_log_is_loggable(int level, const char *tag, int otherwise) { (void)tag; return level >= otherwise; }

// Android's mutex has 40 bytes, 4-aligned, all zeros at first; glibc's on arm64 has 48. The first eight bytes hold a real one.
static pthread_mutex_t *mutex(void *theirs) {
  uintptr_t *slot = (uintptr_t *)(((uintptr_t)theirs + 7) & ~(uintptr_t)7);
  uintptr_t found = __atomic_load_n(slot, __ATOMIC_ACQUIRE);
  // Their static initialisers put a kind into the first 16 bits: recursive is 0x4000.
  if (found == 0 || found == 0x4000 || found == 0x8000) {
    pthread_mutex_t *made = malloc(sizeof *made);
    pthread_mutexattr_t kind;
    pthread_mutexattr_init(&kind);
    pthread_mutexattr_settype(&kind, found == 0x4000 ? PTHREAD_MUTEX_RECURSIVE : PTHREAD_MUTEX_NORMAL);
    pthread_mutex_init(made, &kind);
    if (__atomic_compare_exchange_n(slot, &found, (uintptr_t)made, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE)) return made;
    free(made);
  }
  return (pthread_mutex_t *)found;
}
int bionic_pthread_mutex_init(void *m, const long *attributes) {
  memset(m, 0, 40);
  // Their attribute is a number whose low four bits are the type.
  if (attributes != NULL && (*attributes & 15) == 1) *(uintptr_t *)(((uintptr_t)m + 7) & ~(uintptr_t)7) = 0x4000;
  mutex(m);
  return 0;
}
int bionic_pthread_mutex_destroy(void *m) { pthread_mutex_t *own = mutex(m); int code = pthread_mutex_destroy(own); if (code == 0) { free(own); memset(m, 0, 40); } return code; }
int bionic_pthread_mutex_lock(void *m) { return pthread_mutex_lock(mutex(m)); }
int bionic_pthread_mutex_trylock(void *m) { return pthread_mutex_trylock(mutex(m)); }
int bionic_pthread_mutex_unlock(void *m) { return pthread_mutex_unlock(mutex(m)); }

// 48 bytes on both, but glibc's static initialiser and clock bits are its own: a real one on the heap too.
static pthread_cond_t *condition(void *theirs) {
  uintptr_t *slot = (uintptr_t *)(((uintptr_t)theirs + 7) & ~(uintptr_t)7);
  uintptr_t found = __atomic_load_n(slot, __ATOMIC_ACQUIRE);
  if (found == 0) {
    pthread_cond_t *made = malloc(sizeof *made);
    pthread_condattr_t clock;
    pthread_condattr_init(&clock);
    pthread_cond_init(made, &clock);
    if (__atomic_compare_exchange_n(slot, &found, (uintptr_t)made, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE)) return made;
    free(made);
  }
  return (pthread_cond_t *)found;
}
int bionic_pthread_cond_init(void *c, const void *attributes) { (void)attributes; memset(c, 0, 48); condition(c); return 0; }
int bionic_pthread_cond_destroy(void *c) { pthread_cond_t *own = condition(c); int code = pthread_cond_destroy(own); free(own); memset(c, 0, 48); return code; }
int bionic_pthread_cond_broadcast(void *c) { return pthread_cond_broadcast(condition(c)); }
int bionic_pthread_cond_signal(void *c) { return pthread_cond_signal(condition(c)); }
int bionic_pthread_cond_wait(void *c, void *m) { return pthread_cond_wait(condition(c), mutex(m)); }
int bionic_pthread_cond_timedwait(void *c, void *m, const struct timespec *at) { return pthread_cond_timedwait(condition(c), mutex(m), at); }

// Attributes of threads: 56 bytes there, 64 on glibc's arm64. Only the stack's size is asked for.
struct attributes { size_t stack_bytes; };
int bionic_pthread_attr_init(struct attributes *a) { a->stack_bytes = 0; return 0; }
int bionic_pthread_attr_destroy(struct attributes *a) { (void)a; return 0; }
int bionic_pthread_attr_setstacksize(struct attributes *a, size_t bytes) { a->stack_bytes = bytes; return 0; }
int bionic_pthread_create(long *thread, const struct attributes *a, void *(*body)(void *), void *argument) {
  pthread_attr_t own;
  pthread_attr_init(&own);
  if (a != NULL && a->stack_bytes != 0) pthread_attr_setstacksize(&own, a->stack_bytes);
  pthread_t made;
  int code = pthread_create(&made, &own, body, argument);
  pthread_attr_destroy(&own);
  *thread = (long)made;
  return code;
}

// A window of the screen: memory, written as a picture to the file that BOXLINE_FAKE_WINDOW names each time it is shown.
struct buffer { int32_t width, height, stride, format; void *bits; uint32_t reserved[6]; };
static struct { int width, height; uint32_t *pixels; } window = {800, 600, NULL};
void *bionic_ANativeWindow_fromSurface(void *env, void *surface) { (void)env; return surface == NULL ? NULL : &window; }
void bionic_ANativeWindow_acquire(void *w) { (void)w; }
void bionic_ANativeWindow_release(void *w) { (void)w; }
int bionic_ANativeWindow_getWidth(void *w) { (void)w; return 800; }
int bionic_ANativeWindow_getHeight(void *w) { (void)w; return 600; }
int bionic_ANativeWindow_getFormat(void *w) { (void)w; return 1; }
int bionic_ANativeWindow_setBuffersGeometry(void *w, int width, int height, int format) {
  (void)w; (void)format;
  window.width = width;
  window.height = height;
  return 0;
}
int bionic_ANativeWindow_lock(void *w, struct buffer *out, void *dirty) {
  (void)w; (void)dirty;
  window.pixels = calloc((size_t)(window.width + 24) * window.height, 4);
  *out = (struct buffer){window.width, window.height, window.width + 24, 1, window.pixels, {0}};
  return 0;
}
int bionic_ANativeWindow_unlockAndPost(void *w) {
  (void)w;
  const char *path = getenv("BOXLINE_FAKE_WINDOW");
  FILE *file = path == NULL ? NULL : fopen(path, "wb");
  if (file != NULL) {
    fprintf(file, "P6 %d %d 255\n", window.width, window.height);
    for (int y = 0; y < window.height; y++)
      for (int x = 0; x < window.width; x++) fwrite(&window.pixels[y * (window.width + 24) + x], 3, 1, file);
    fclose(file);
  }
  free(window.pixels);
  return 0;
}

static void unknown(void) {
  fprintf(stderr, "[shim] a function was called that this machine does not have\n");
  abort();
}

void shim_fill(const struct row *rows, int count) {
  void *self = dlopen("libshimcore.so", RTLD_NOW | RTLD_NOLOAD);
  for (int i = 0; i < count; i++) {
    char name[100];
    snprintf(name, sizeof name, "bionic_%s", rows[i].name);
    void *found = self == NULL ? NULL : dlsym(self, name);
    // The first in the program's own order: what was loaded before everything else may stand in (the fake head's ioctl and poll).
    if (found == NULL) found = dlsym(RTLD_DEFAULT, rows[i].name);
    if (found == NULL) fprintf(stderr, "[shim] no host symbol %s\n", rows[i].name);
    *rows[i].at = found == NULL ? (void *)unknown : found;
  }
}
