/* Writes one frame of each kind that a firmware sends, as hexadecimal lines, with the numbers of the
 * examples in docs/reference/serial.md; then answers the frames on standard input (a line each). */
#define TRIGPOINT_IMPLEMENTATION
#include "trigpoint_serial.h"

#include <stdio.h>

static void write_hex(void *user, const uint8_t *data, size_t size) {
    (void)user;
    for (size_t i = 0; i < size; i++) printf("%02x", data[i]);
    printf("\n");
}

int main(void) {
    static trigpoint self;
    static const trigpoint_wheels wheels = {0.00025f, 0.00025f, 0.3f, 32};
    trigpoint_config config = {write_hex, NULL, NULL, "r1", "rover 1.4", 0x12345678};
    trigpoint_pose pose = {1.5, -0.25, 1.5707963267948966};
    unsigned byte;
    trigpoint_begin(&self, &config);
    self.sequence = 513;
    trigpoint_odometry(&self, 2500000000u, pose, 0.5f, -0.25f);
    self.sequence = 517;
    trigpoint_ticks(&self, 2500000000u, 1500, 0xffffff00u, &wheels);
    while (scanf("%2x", &byte) == 1) trigpoint_receive(&self, (uint8_t)byte, 2500100000u);
    printf("received %u rejected %u\n", self.received, self.rejected);
    return 0;
}
