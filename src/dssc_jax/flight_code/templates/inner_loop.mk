# The bench of the inner loop: the same bits on recorded flights.
INNER_LOOP_FILES := @{name}.c inner_loop_bench.c
INNER_LOOP_NEEDED := $(INNER_LOOP_FILES) @{name}.h
INNER_LOOP_RECORDED ?= inner_loop.bin

.PHONY: inner-loop-check inner-loop-cpp inner-loop-clang inner-loop-arm64 inner-loop-armhf inner-loop-sanitized inner-loop-clean

check: inner-loop-check
cpp: inner-loop-cpp
clang: inner-loop-clang
arm64: inner-loop-arm64
armhf: inner-loop-armhf
sanitized: inner-loop-sanitized
clean: inner-loop-clean

inner-loop-check: inner-loop-bench
	./inner-loop-bench $(INNER_LOOP_RECORDED)

inner-loop-cpp: $(INNER_LOOP_NEEDED)
	$(CXX) $(STRICTER) -x c++ -c @{name}.c -o inner-loop-cpp.o
	$(CC) $(STRICT) inner_loop_bench.c inner-loop-cpp.o -o inner-loop-bench-cpp -lm
	./inner-loop-bench-cpp $(INNER_LOOP_RECORDED)

inner-loop-clang: $(INNER_LOOP_NEEDED)
	clang $(STRICT) $(INNER_LOOP_FILES) -o inner-loop-bench-clang -lm
	./inner-loop-bench-clang $(INNER_LOOP_RECORDED)

inner-loop-arm64: $(INNER_LOOP_NEEDED)
	aarch64-linux-gnu-gcc $(STRICT) $(INNER_LOOP_FILES) -o inner-loop-bench-arm64 -lm
	$(QEMU_ARM64) ./inner-loop-bench-arm64 $(INNER_LOOP_RECORDED)

inner-loop-armhf: $(INNER_LOOP_NEEDED)
	arm-linux-gnueabihf-gcc $(STRICT) $(INNER_LOOP_FILES) -o inner-loop-bench-armhf -lm
	$(QEMU_ARMHF) ./inner-loop-bench-armhf $(INNER_LOOP_RECORDED)

inner-loop-sanitized: $(INNER_LOOP_NEEDED)
	$(CC) $(STRICT) -g -fsanitize=address,undefined -fno-sanitize-recover=all $(INNER_LOOP_FILES) -o inner-loop-bench-sanitized -lm
	./inner-loop-bench-sanitized $(INNER_LOOP_RECORDED)

inner-loop-bench: $(INNER_LOOP_NEEDED)
	$(CC) $(STRICT) $(INNER_LOOP_FILES) -o $@@ -lm

inner-loop-clean:
	rm -f inner-loop-bench inner-loop-bench-*
