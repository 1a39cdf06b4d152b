# The monitor's bench: the same flags and the same bits on recorded flights.
MONITOR_FILES := @{name}.c monitor_bench.c
MONITOR_NEEDED := $(MONITOR_FILES) @{name}.h
MONITORED ?= monitored.bin

.PHONY: monitor-check monitor-cpp monitor-clang monitor-arm64 monitor-armhf monitor-sanitized monitor-clean

check: monitor-check
cpp: monitor-cpp
clang: monitor-clang
arm64: monitor-arm64
armhf: monitor-armhf
sanitized: monitor-sanitized
clean: monitor-clean

monitor-check: monitor-bench
	./monitor-bench $(MONITORED)

monitor-cpp: $(MONITOR_NEEDED)
	$(CXX) $(STRICTER) -x c++ -c @{name}.c -o monitor-cpp.o
	$(CC) $(STRICT) monitor_bench.c monitor-cpp.o -o monitor-bench-cpp -lm
	./monitor-bench-cpp $(MONITORED)

monitor-clang: $(MONITOR_NEEDED)
	clang $(STRICT) $(MONITOR_FILES) -o monitor-bench-clang -lm
	./monitor-bench-clang $(MONITORED)

monitor-arm64: $(MONITOR_NEEDED)
	aarch64-linux-gnu-gcc $(STRICT) $(MONITOR_FILES) -o monitor-bench-arm64 -lm
	$(QEMU_ARM64) ./monitor-bench-arm64 $(MONITORED)

monitor-armhf: $(MONITOR_NEEDED)
	arm-linux-gnueabihf-gcc $(STRICT) $(MONITOR_FILES) -o monitor-bench-armhf -lm
	$(QEMU_ARMHF) ./monitor-bench-armhf $(MONITORED)

monitor-sanitized: $(MONITOR_NEEDED)
	$(CC) $(STRICT) -g -fsanitize=address,undefined -fno-sanitize-recover=all $(MONITOR_FILES) -o monitor-bench-sanitized -lm
	./monitor-bench-sanitized $(MONITORED)

monitor-bench: $(MONITOR_NEEDED)
	$(CC) $(STRICT) $(MONITOR_FILES) -o $@@ -lm

monitor-clean:
	rm -f monitor-bench monitor-bench-*
