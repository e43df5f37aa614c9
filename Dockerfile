# docker build -t motionkit . && docker run --rm -v "$PWD:/data" motionkit info
FROM python:3.11-slim
# torch for CPUs; with a GPU: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu126
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt --extra-index-url ${TORCH_INDEX} '/src[text]' \
    && rm -r /src
WORKDIR /data
ENTRYPOINT ["motionkit"]
