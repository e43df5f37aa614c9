# docker build -t motionkit . && docker run --rm -u "$(id -u):$(id -g)" -v "$PWD:/data" motionkit info
FROM python:3.11-slim
# torch for CPUs; with a GPU: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu126
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt --extra-index-url ${TORCH_INDEX} '/src[text]' \
    && rm -r /src
RUN useradd motionkit && install -d -o motionkit /data
USER motionkit
# Of whatever user -u names.
ENV HOME=/tmp
WORKDIR /data
ENTRYPOINT ["motionkit"]
