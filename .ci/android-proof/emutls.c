// Thread-local variables of C below API 29: one allocation a variable and thread, kept under a key of the system.
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

struct control {
  size_t size, align;
  pthread_key_t *key;
  const void *initial;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

void *__emutls_get_address(struct control *control) {
  pthread_mutex_lock(&lock);
  if (control->key == NULL) {
    pthread_key_t *key = malloc(sizeof *key);
    if (key == NULL || pthread_key_create(key, free) != 0) abort();
    control->key = key;
  }
  pthread_mutex_unlock(&lock);
  void *value = pthread_getspecific(*control->key);
  if (value == NULL) {
    size_t align = control->align < sizeof(void *) ? sizeof(void *) : control->align;
    if (posix_memalign(&value, align, control->size) != 0) abort();
    if (control->initial != NULL) memcpy(value, control->initial, control->size);
    else memset(value, 0, control->size);
    if (pthread_setspecific(*control->key, value) != 0) abort();
  }
  return value;
}
